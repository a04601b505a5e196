"""Search for schedules that violate an invariant, and replay of one of them."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from itertools import count, islice
from multiprocessing import get_context
from time import perf_counter

from tests.faults.planted_bugs import PLANTED
from tests.faults.schedule import Schedule, draw, shrink
from tests.faults.world import simulate

CHUNK = 20  # schedules per task of a process


def violations(schedule: Schedule, bug: str | None = None) -> list[str]:
    """Return the violated invariants of a schedule."""
    return simulate(schedule, PLANTED[bug].plant if bug else _plant_nothing).violations


def replay(seed: int, bug: str | None) -> int:
    """Simulate one seed, shrink its faults if it violates an invariant, and print both."""
    schedule = draw(seed)
    found = violations(schedule, bug)
    if found:
        schedule = shrink(schedule, lambda fewer: bool(violations(fewer, bug)))
        found = violations(schedule, bug)
    print(f"seed {seed}{', fewest faults that violate an invariant' if found else ''}:")
    print("\n".join(f"  {fault}" for fault in schedule.faults) or "  no fault is needed")
    print("\n".join(f"violated: {each}" for each in found) or "no invariant is violated")
    return 1 if found else 0


def search(first: int, limit: int | None, jobs: int, bug: str | None) -> int:
    """Simulate schedules until `limit` or an interrupt; print the rate and each violation."""
    start, done, failed = perf_counter(), 0, 0
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        for seeds, found in _completed(pool, _chunks(first, limit), 2 * jobs, bug):
            done += len(seeds)
            failed += len(found)
            for seed, texts in found.items():
                print(f"\nseed {seed}: {texts[0]}\n  replay and shrink: {command(seed, bug)}", flush=True)
            rate = done / (perf_counter() - start) * 60
            print(f"\r{done} schedules, {failed} violations, {rate:.0f} per minute", end="", flush=True)
    print()
    return 1 if failed else 0


def command(seed: int, bug: str | None = None) -> str:
    """Return the command that replays a seed."""
    return f".venv/bin/python -m tests.faults --seed {seed}" + (f" --bug '{bug}'" if bug else "")


def _chunks(first: int, limit: int | None) -> Iterator[range]:
    for start in count(first, CHUNK) if limit is None else range(first, first + limit, CHUNK):
        yield range(start, start + CHUNK if limit is None else min(start + CHUNK, first + limit))


def _completed(
    pool: ProcessPoolExecutor, chunks: Iterator[range], ahead: int, bug: str | None
) -> Iterator[tuple[range, dict[int, list[str]]]]:
    """Yield the results of chunks in order, with `ahead` of them submitted."""
    pending = deque(pool.submit(_chunk, seeds, bug) for seeds in islice(chunks, ahead))
    while pending:
        yield pending.popleft().result()
        pending += [pool.submit(_chunk, seeds, bug) for seeds in islice(chunks, 1)]


def _chunk(seeds: range, bug: str | None) -> tuple[range, dict[int, list[str]]]:
    found = {seed: violations(draw(seed), bug) for seed in seeds}
    return seeds, {seed: texts for seed, texts in found.items() if texts}


def _plant_nothing(stack: ExitStack) -> None:
    del stack

"""Search for schedules that violate an invariant, and replay of one of them."""

from functools import partial
from itertools import count
from multiprocessing import get_context
from time import perf_counter

from tests.faults.planted_bugs import PLANTED
from tests.faults.schedule import Schedule, draw, shrink
from tests.faults.world import simulate

CHUNK = 20  # schedules per task of a process
TASKS = 25  # of a process; then another one takes over: it grows by a quarter of a MB per schedule


def violations(schedule: Schedule, bug: str | None = None) -> list[str]:
    """Return the violated invariants of a schedule."""
    return simulate(schedule, *([PLANTED[bug].plant] if bug else [])).violations


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
    seeds = count(first) if limit is None else range(first, first + limit)
    start, failed = perf_counter(), 0
    with get_context("spawn").Pool(jobs, maxtasksperchild=TASKS) as pool:
        for done, (seed, found) in enumerate(pool.imap(partial(_checked, bug=bug), seeds, CHUNK), 1):
            if found:
                failed += 1
                print(f"\nseed {seed}: {found[0]}\n  replay and shrink: {command(seed, bug)}", flush=True)
            if done % CHUNK == 0 or done == limit:
                rate = done / (perf_counter() - start) * 60
                print(f"\r{done} schedules, {failed} violations, {rate:.0f} per minute", end="", flush=True)
    print()
    return 1 if failed else 0


def command(seed: int, bug: str | None = None) -> str:
    """Return the command that replays a seed."""
    return f".venv/bin/python -m tests.faults --seed {seed}" + (f" --bug '{bug}'" if bug else "")


def _checked(seed: int, bug: str | None) -> tuple[int, list[str]]:
    return seed, violations(draw(seed), bug)

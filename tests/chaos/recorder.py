"""Kills of a recorder: few rows are lost, all others are correct."""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

import numpy as np

from operators import EVERY, Motion, SlipflowError, Touch, concat
from storage import Session, verify
from tests.chaos import children
from tests.chaos.numbered import Numbers, motion, prefix, touch
from tests.chaos.processes import PATIENCE, Child, scratch
from tests.chaos.run import Promise, Scale
from tests.waiting import wait_until

BOUND = 10  # rows of a stream
RATES = (100.0, 1000.0)  # rows/s
SHORTEST, SPREAD = 0.2, 2.0  # s, shortest duration of a recording, and largest addition to it
COUNTS = 4  # counts of a recorder


@dataclass(frozen=True)
class Remains:
    """Rows after one kill."""

    produced: Numbers  # (2,) rows of touch and motion
    accepted: Numbers  # (2,) those that the dataset accepted
    found: Numbers  # (2,) recovered rows
    wrong: str  # names of the checks that failed; empty: none


def kills(scale: Scale) -> list[Promise]:
    """Kill recorders at random times, at the rig's rates and at ten times those."""
    random = np.random.default_rng(scale.seed)
    waves, pairs = (1, 3) if scale.short else (50, 2)
    remains_by_rate = dict[float, list[Remains | str]]((rate, []) for rate in RATES)
    for _ in range(waves):
        with scratch() as folder:
            for rate, remains in _wave(random, folder, RATES * pairs):
                remains_by_rate[rate].append(remains)
    return [_evaluate(rate, each) for rate, each in remains_by_rate.items()]


def _evaluate(rate: float, results: Sequence[Remains | str]) -> Promise:
    count, remains = len(results), [each for each in results if isinstance(each, Remains)]
    produced = np.array([each.produced for each in remains])  # (n, 2)
    accepted = np.array([each.accepted for each in remains])  # (n, 2)
    found = np.array([each.found for each in remains])  # (n, 2)
    lost, queued = accepted - found, produced - accepted
    correct = sum(not each.wrong for each in remains)
    recovered = 100 * np.minimum(found, accepted).sum() / accepted.sum()
    errors = "".join(
        f"; {each}"
        for each in (*results, *(each.wrong for each in remains))
        if each and isinstance(each, str)
    )
    return Promise(
        f"recorder: SIGKILL x{count} at {rate:g} and {children.MOTION_FACTOR * rate:g} rows/s",
        f"at most {lost.max()} accepted rows lost, {recovered:.1f} % recovered; {correct} of {count} sessions"
        f" open with correct rows; at most {queued.max()} more rows lost from the queue{errors}",
        f"<= {BOUND} rows of a table, {count} of {count}",
        passed=bool(lost.max() <= BOUND) and correct == count,
    )


def _wave(
    random: np.random.Generator, folder: Path, rates: Sequence[float]
) -> Iterator[tuple[float, Remains | str]]:
    """Run some recorders at the same time, kill each at its own time, and read their sessions."""
    with ExitStack() as stack:
        datasets = [folder / str(number) for number in range(len(rates))]
        count_files = [folder / f"{dataset.name}.counts" for dataset in datasets]
        for path in count_files:
            path.write_bytes(bytes(COUNTS * 8))
        counts = [np.memmap(path, np.int64, "r") for path in count_files]
        recorders = [
            Child(folder, "record", dataset, path, f"{rate:g}")
            for dataset, path, rate in zip(datasets, count_files, rates, strict=True)
        ]
        for child in recorders:
            child.start()
            stack.callback(child.stop)
        wait_until(lambda: all(each[children.ACCEPTED].all() for each in counts), within=PATIENCE)
        began, durations = time.monotonic(), [SHORTEST + random.uniform(0, SPREAD) for _ in rates]
        for end, child in sorted(zip(durations, recorders, strict=True), key=itemgetter(0)):
            time.sleep(max(0.0, began + end - time.monotonic()))
            child.stop()
        for dataset, each, rate in zip(datasets, counts, rates, strict=True):
            yield rate, _read(dataset, np.array(each), rate)


def _read(path: Path, counts: Numbers, rate: float) -> Remains | str:
    try:
        session = Session.open(path)
        touch_rows = concat(Touch, list(session.read(Touch, 0)))
        motion_rows = concat(Motion, list(session.read(Motion, EVERY)))
        checks = {
            "touch": prefix(touch_rows, touch, rate),
            "motion": prefix(motion_rows, motion, children.MOTION_FACTOR * rate),
            "verify": verify(path).code in {0, 3},
        }
    except SlipflowError as error:
        return str(error)
    found = np.array([len(touch_rows), len(motion_rows)])
    wrong = ", ".join(name for name, correct in checks.items() if not correct)
    return Remains(counts[children.PRODUCED], counts[children.ACCEPTED], found, wrong)

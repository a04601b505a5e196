"""A recorder is killed at any time: what is lost is a few rows, and what is left is right."""

import asyncio
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flows.graph.testing import TestSink
from flows.run.replay_runner import ReplayRunner
from operators import EVERY, Episodes, Labelled, Motion, SlipflowError, Slips, Touch, concat, ms
from storage import Session, recover, verify
from tests.chaos import record
from tests.chaos.child import PATIENCE
from tests.chaos.numbered import Numbers, motion, prefix, touch
from tests.chaos.processes import kill, scratch, start
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.storage import disk_steps
from tests.storage.made import new_run

BOUND = 10  # rows of a stream
UNSURE = 60 * ms  # of the newest samples: they may know rows of the arm that were lost
RATES = (100.0, 1000.0)  # rows/s
SETTLED, SPREAD = 0.2, 2.0  # s, that a recording goes on for at least, and at most more than that
COUNTS = 5  # numbers that a recorder counts
OTHERS = "ParquetWriter 2,460 rows lost, 0 % back; parts of 100 rows 100, 95.8 %; MCAP 418, 91.8 %"
KEPT = ("time", "counts", "valid", "velocity", "speed", "label")  # of a sample


@dataclass(frozen=True)
class Remains:
    """What one kill left."""

    given: Numbers  # (2,) rows of touch and motion
    taken: Numbers  # (3,) rows of touch, motion and samples that the dataset took
    found: Numbers  # (3,) rows that are there again
    wrong: str  # what of them is not as it was given; empty: all is


def kills(scale: Scale) -> list[Promise]:
    """SIGKILL at random, at the rig's rates and at ten times those."""
    random = np.random.default_rng(scale.seed)
    waves, pairs = (1, 3) if scale.short else (50, 2)
    left = dict[float, list[Remains | str]]((rate, []) for rate in RATES)
    for _ in range(waves):
        with scratch() as folder:
            for rate, remains in _wave(random, folder, RATES * pairs):
                left[rate].append(remains)
    return [_judged(rate, each) for rate, each in left.items()]


def steps(scale: Scale) -> Promise:
    """Ended at each step of a recording on the disk."""
    del scale  # there are no fewer steps
    worst, whole, ends = 0, True, 0
    with scratch(memory=True) as folder:
        names = disk_steps.steps_of(partial(disk_steps.record, folder / "whole", new_run(), []))
        for number in disk_steps.each_kind(names):
            place, taken = folder / str(number), list[int]()
            disk_steps.end_at(number, partial(disk_steps.record, place, new_run(), taken))
            if not (place / "sessions/one/session.json").exists():
                continue
            ends += 1
            whole &= recover(place / "sessions/one").complete
            session = Session.open(place)
            for kind, finger in ((Touch, 0), (Motion, EVERY), (Slips, 0), (Episodes, EVERY)):
                rows = concat(kind, list(session.read(kind, finger)))
                whole &= rows.time.tolist() == [number * 10 * ms for number in range(len(rows))]
                worst = max(worst, len(taken) - len(rows))
            whole &= verify(place).code in {0, 3}
    return Promise(
        f"recorder: ended at {ends} steps on the disk, of {len(set(names))} kinds",
        f"{worst} rows lost at worst, {'all' if whole else 'NOT all'} right",
        f"<= {BOUND} rows, all right",
        kept=worst <= BOUND and whole,
    )


def _judged(rate: float, left: Sequence[Remains | str]) -> Promise:
    count, remains = len(left), [each for each in left if isinstance(each, Remains)]
    given = np.array([each.given for each in remains])  # (n, 2)
    taken = np.array([each.taken for each in remains])  # (n, 3)
    found = np.array([each.found for each in remains])  # (n, 3)
    lost, queued = taken - found, given - taken[:, :2]
    right = sum(not each.wrong for each in remains)
    back = 100 * np.minimum(found, taken).sum() / taken.sum()
    errors = "".join(
        f"; {each}" for each in (*left, *(each.wrong for each in remains)) if each and isinstance(each, str)
    )
    return Promise(
        f"recorder: SIGKILL x{count} at {rate:g} and {record.FASTER * rate:g} rows/s",
        f"{lost.max()} of the rows taken lost at worst, {back:.1f} % back; {right} of {count} open and right;"
        f" {queued.max()} more rows were queued{errors}",
        f"<= {BOUND} rows of a table, {count} of {count}",
        kept=bool(lost.max() <= BOUND) and right == count,
        others=OTHERS,
    )


def _wave(
    random: np.random.Generator, folder: Path, rates: Sequence[float]
) -> Iterator[tuple[float, Remains | str]]:
    """Let some recorders run side by side, each up to its own end; look at what is left."""
    with ExitStack() as stack:
        places = [folder / str(number) for number in range(len(rates))]
        counted = [folder / f"{place.name}.counts" for place in places]
        for path in counted:
            path.write_bytes(bytes(COUNTS * 8))
        counts = [np.memmap(path, np.int64, "r") for path in counted]
        children = [
            start("record", place, path, f"{rate:g}")
            for place, path, rate in zip(places, counted, rates, strict=True)
        ]
        for child in children:
            stack.callback(child.kill)
        _await(counts)
        began, ends = time.monotonic(), [SETTLED + random.uniform(0, SPREAD) for _ in rates]
        for end, child in sorted(zip(ends, children, strict=True), key=itemgetter(0)):
            time.sleep(max(0.0, began + end - time.monotonic()))
            kill(child)
        for place, each, rate in zip(places, counts, rates, strict=True):
            yield rate, _look(place, np.array(each), rate)


def _await(counts: Sequence[NDArray[np.int64]]) -> None:
    """All of them take rows."""
    deadline = time.monotonic() + PATIENCE
    while not all(each[record.TAKEN].all() for each in counts):
        if time.monotonic() > deadline:
            raise TimeoutError("a recorder takes no rows")
        time.sleep(0.01)


def _look(place: Path, counts: Numbers, rate: float) -> Remains | str:
    try:
        session = Session.open(place)
        felt = concat(Touch, list(session.read(Touch, 0)))
        moved = concat(Motion, list(session.read(Motion, EVERY)))
        samples = concat(Labelled, list(session.read(Labelled, 0)))
        checks = {
            "touch": prefix(felt, touch, rate),
            "motion": prefix(moved, motion, record.FASTER * rate),
            "samples": _derived(session, samples, rate),
            "verify": verify(place).code in {0, 3},
        }
    except SlipflowError as error:
        return str(error)
    found = np.array([len(felt), len(moved), len(samples)])
    wrong = ", ".join(name for name, right in checks.items() if not right)
    return Remains(counts[record.GIVEN], counts[record.TAKEN], found, wrong)


def _derived(session: Session, samples: Labelled, rate: float) -> bool:
    """Whether the recorded samples are those that the flow makes of the recorded rows."""
    sink = TestSink()
    flow = record.declared(sink, rate, np.zeros(2, np.int64))
    asyncio.run(ReplayRunner(flow, session, "again").execute())
    again = sink.rows(Labelled, 0)
    newest = min(sink.rows(Touch, 0).time[-1], sink.rows(Motion).time[-1]) - UNSURE
    sure, made = samples[samples.time < newest], again[again.time < newest]
    same = all(
        getattr(sure, name).tobytes() == getattr(made[: len(sure)], name).tobytes()  # NaN included
        for name in KEPT
    )
    return same and len(made) - len(sure) <= BOUND


PROMISES = (kills, steps)

"""The job that every engine is given, how its cost is taken, and what it hands back.

Each engine's program is run as ``python -m tests.benchmarks.peers.<name> JOB RESULT ROWS`` in an environment
of its own, which has numpy and that engine, and nothing of ours. JOB and RESULT are numpy files without
pickle. Making the engine's own input of the arrays, as records or chunks, is not its cost; nor is reading.
The program does the job twice, and the second time counts: the first one imports, compiles and fills caches.
"""

import gc
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

PERIOD: Final = 10_000_000  # ns, of a fingertip; a sample comes within 2 ms after it begins
BASELINE: Final = 400  # counts of the unloaded fingertip
WITHIN: Final = 20_000_000  # ns, by which motion may be older than the touch it belongs to
SLIP: Final = 0.003  # m/s, above which the label is slip
LIMIT: Final = 0.3  # m/s, from which it is unknown
LENGTH: Final = 100  # samples of a window
HALF: Final = 400.0  # counts^2, the mean energy of a window's steps at which the score is one half
MOTION: Final = -1  # in the place of a fingertip, of what belongs to the arm

Record: TypeAlias = tuple[int, int, Any]  # fingertip or MOTION; ns; six counts or six velocities
Chunk: TypeAlias = tuple[int, NDArray[np.int64], NDArray[Any]]  # the same of rows: (k,), (k, 6)
Judged: TypeAlias = tuple[int, Any, Any]  # fingertip, label, score: of a sample or of an array of them


class Job(NamedTuple):
    """Streams of fingertips and of the arm that carries them, each in the order of its time."""

    time: NDArray[np.int64]  # (fingers, n) ns
    counts: NDArray[np.int16]  # (fingers, n, 6)
    motion_time: NDArray[np.int64]  # (m,) ns
    velocity: NDArray[np.float64]  # (m, 6) m/s, rad/s

    def records(self) -> list[Record]:
        """Both streams as they come live: in the order of time, motion first where stamps are equal."""
        records: list[Record] = [
            (MOTION, time, tuple(velocity))
            for time, velocity in zip(self.motion_time.tolist(), self.velocity.tolist(), strict=True)
        ]
        for finger, (times, counts) in enumerate(zip(self.time.tolist(), self.counts.tolist(), strict=True)):
            records += [(finger, time, tuple(row)) for time, row in zip(times, counts, strict=True)]
        records.sort(key=lambda record: record[1])  # stable
        return records

    def spans(self, rows: int) -> Iterator[list[Chunk]]:
        """Spans of time that hold `rows` samples of each fingertip: motion first, then each fingertip."""
        starts = range(0, self.time.shape[1] + rows, rows)
        edges = np.array([start * PERIOD for start in starts], np.int64)  # ns
        moved: list[int] = self.motion_time.searchsorted(edges).tolist()
        felt: list[list[int]] = [time.searchsorted(edges).tolist() for time in self.time]
        for i in range(len(edges) - 1):
            part = slice(moved[i], moved[i + 1])
            span: list[Chunk] = [(MOTION, self.motion_time[part], self.velocity[part])]
            for finger, cuts in enumerate(felt):
                part = slice(cuts[i], cuts[i + 1])
                span.append((finger, self.time[finger, part], self.counts[finger, part]))
            yield span


class Meter:
    """CPU time of this process, all its threads and the children it has waited for, while it is entered."""

    def __init__(self) -> None:
        self.spent = 0.0  # s

    def __enter__(self) -> None:
        gc.collect()
        gc.disable()
        self._began = _used()

    def __exit__(self, *_: object) -> None:
        self.spent = _used() - self._began
        gc.enable()


Run: TypeAlias = Callable[[Meter], Iterable[Judged]]  # enters the meter while it works


def carry_out(prepare: Callable[[Job, int], Run]) -> None:
    """Do what the command line says: read, let the program prepare its input, run, and write."""
    source, target, rows = sys.argv[1:]
    with np.load(source, allow_pickle=False) as arrays:
        job = Job(**arrays)
    run, meter = prepare(job, int(rows)), Meter()
    run(meter)  # warms up
    judged = list(run(meter))
    fingers = [np.full(np.size(label), finger) for finger, label, _ in judged]
    labels, scores = (np.concatenate([np.atleast_1d(row[k]) for row in judged]) for k in (1, 2))
    finger = np.concatenate(fingers)
    order = np.argsort(finger, kind="stable")
    np.savez(target, label=labels[order].astype(np.int8), score=scores[order], spent=meter.spent)


def _used() -> float:
    children = os.times()
    return time.process_time() + children.children_user + children.children_system

"""Samples handed over when they are due, and how long each takes to its event.

A live program is run as ``python -m tests.benchmarks.peers.<name> JOB RESULT DETECTOR``. Of the job it takes
the touch alone, whose stamps say when each sample is due. Its path is that of detection: counts to zero, the
score of the window, the event, which is that score; the arm's motion has no part in it. The feeder stamps a
sample when it hands it over, the sink takes the time when the event is there, both in `perf_counter_ns`.
"""

import gc
import sys
import time
from collections.abc import Callable
from typing import Final

import numpy as np

from tests.benchmarks.peers.job import LENGTH, Job, Record

HEADSTART: Final = 500_000_000  # ns, from the beginning to the first sample


class Live:
    """What a live program is given, and where its events go."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self.records: list[Record] = job.records()
        self.expected = len(job.time) * (job.time.shape[1] - LENGTH + 1)  # events, of full windows
        self.fingers, self.delays, self.scores = list[int](), list[int](), list[float]()
        self.cpu = self.wall = 0.0  # s, from the beginning to the last event

    def begin(self) -> None:
        """The stream begins; called by what feeds it, once the engine runs."""
        self._origin = time.perf_counter_ns() + HEADSTART
        self._cpu, self._began = time.process_time(), time.perf_counter()

    def wait(self, due: int) -> float:
        """How long until a sample is due, s; at most 0 if it is."""
        return (self._origin + due - time.perf_counter_ns()) / 1e9

    def told(self, finger: int, stamp: int, score: float) -> bool:
        """An event is there, of the sample handed over at `stamp`; says whether it is the last one."""
        self.delays.append(time.perf_counter_ns() - stamp)
        self.fingers.append(finger)
        self.scores.append(score)
        if len(self.scores) < self.expected:
            return False
        self.cpu = time.process_time() - self._cpu
        self.wall = time.perf_counter() - self._began
        return True


def carry_out_live(run: Callable[[Live, str], None]) -> None:
    """Do what the command line says: read, run to the last event, write."""
    source, target, detector = sys.argv[1:]
    with np.load(source, allow_pickle=False) as arrays:
        live = Live(Job(**arrays))
    gc.freeze()  # what was read is not searched again
    run(live, detector)
    finger = np.array(live.fingers)
    order = np.argsort(finger, kind="stable")
    np.savez(
        target,
        delay=np.array(live.delays)[order],
        score=np.array(live.scores, np.float64)[order],
        used=live.cpu / live.wall if live.wall else np.nan,
    )

"""The job's steps for engines that take one record at a time, in plain Python: floats, tuples and a deque."""

from collections import deque
from math import hypot
from typing import TypeAlias

from tests.benchmarks.peers.job import BASELINE, HALF, LENGTH, LIMIT, SLIP, WITHIN

Counts: TypeAlias = tuple[int, int, int, int, int, int]
Velocity: TypeAlias = tuple[float, float, float, float, float, float]


def zeroed(counts: Counts) -> Counts:
    """Relative to the unloaded fingertip."""
    a, b, c, d, e, f = counts
    return a - BASELINE, b - BASELINE, c - BASELINE, d - BASELINE, e - BASELINE, f - BASELINE


class Newest:
    """The arm's newest motion, the last one up to a touch as records come in the order of time."""

    def __init__(self) -> None:
        self._time = 0  # ns
        self._velocity: Velocity | None = None

    def take(self, time: int, velocity: Velocity) -> None:
        """Remember."""
        self._time, self._velocity = time, velocity

    def at(self, time: int) -> Velocity | None:
        """What belongs to a touch at `time`, if it is near enough."""
        return self._velocity if time - self._time <= WITHIN else None


def label(velocity: Velocity | None) -> int:
    """1 slip, 0 static, -1 unknown."""
    if velocity is None:
        return -1
    speed = hypot(velocity[0], velocity[1])
    return (1 if speed > SLIP else 0) if speed < LIMIT else -1


class Energy:
    """The score of the newest `LENGTH` samples of one fingertip."""

    def __init__(self) -> None:
        self._steps = deque[int]()
        self._total = 0
        self._last: Counts | None = None

    def score(self, counts: Counts) -> float | None:
        """Of the window that the sample completes; None before the first one."""
        a, b, c, d, e, f = counts
        u, v, w, x, y, z = self._last or counts
        self._last = counts
        step = (a - u) ** 2 + (b - v) ** 2 + (c - w) ** 2 + (d - x) ** 2 + (e - y) ** 2 + (f - z) ** 2
        self._steps.append(step)
        self._total += step
        if len(self._steps) < LENGTH:
            return None
        energy = self._total / LENGTH
        self._total -= self._steps.popleft()
        return energy / (energy + HALF)

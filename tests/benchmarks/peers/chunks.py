"""The job's steps for engines that take chunks of rows, in numpy."""

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.peers.job import BASELINE, HALF, LENGTH, LIMIT, SLIP, WITHIN

Times = NDArray[np.int64]
Reals = NDArray[np.float64]


def zeroed(counts: NDArray[np.int16]) -> NDArray[np.int64]:
    """Relative to the unloaded fingertip, (k, 6)."""
    return counts.astype(np.int64) - BASELINE


class Newest:
    """The motion of the newest chunk, and the row before it; it comes before the touches of its span."""

    def __init__(self) -> None:
        self._time = np.array([-WITHIN - 1])  # (k,) ns
        self._velocity = np.full((1, 6), np.nan)  # (k, 6)

    def take(self, time: Times, velocity: Reals) -> None:
        """Remember."""
        self._time = np.concatenate((self._time[-1:], time))
        self._velocity = np.concatenate((self._velocity[-1:], velocity))

    def at(self, time: Times) -> Reals:
        """The rows that belong to touches at `time` (k,); NaN where none is near enough; (k, 6)."""
        before = np.maximum(self._time.searchsorted(time, "right") - 1, 0)
        velocity = self._velocity[before]
        velocity[time - self._time[before] > WITHIN] = np.nan
        return velocity


def label(velocity: Reals) -> NDArray[np.int8]:
    """1 slip, 0 static, -1 unknown; (k,)."""
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    return np.where(speed < LIMIT, speed > SLIP, -1).astype(np.int8)


class Energy:
    """The scores of the newest `LENGTH` samples of one fingertip, at each sample."""

    def __init__(self) -> None:
        self._sums = np.zeros(1, np.int64)  # (LENGTH + 1,) at most: sums of the steps up to each sample
        self._last: NDArray[np.int64] | None = None  # (1, 6)

    def score(self, counts: NDArray[np.int64]) -> Reals:
        """Of the windows that the samples complete: fewer than samples only in the beginning."""
        steps = np.diff(counts, axis=0, prepend=counts[:1] if self._last is None else self._last)
        self._last = counts[-1:]
        sums = np.concatenate((self._sums, self._sums[-1] + np.einsum("ij,ij->i", steps, steps).cumsum()))
        self._sums = sums[-LENGTH:]
        energy = (sums[LENGTH:] - sums[:-LENGTH]) / LENGTH
        scores: Reals = energy / (energy + HALF)
        return scores

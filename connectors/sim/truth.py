"""What really happened in a simulated scene: for tests and summaries, never for a detector."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import Batch, Reals, column, ms

SLIDING: Final = 0.003  # m/s; slower is rest, as in the paper's label
STICK: Final = 150 * ms  # stick-slip has pauses of 50 to 100 ms


@dataclass(frozen=True, slots=True, eq=False)
class Truth(Batch):
    """The scene at the true instants of the touch samples."""

    # (n,) mean over the pad since the last row
    sliding: Reals = field(metadata=column(np.float64, unit="m/s"))
    force: Reals = field(metadata=column(np.float64, unit="N"))  # (n,) normal
    # (n, 3) arm, at the pad's centre, with its shaking
    velocity: Reals = field(metadata=column(np.float64, 3, unit="m/s, rad/s"))

    @property
    def slips(self) -> list[tuple[int, int]]:
        """Onset and end (ns) of every slip; a stick of less than `STICK` is a part of it."""
        at = self.time[self.sliding > SLIDING]  # (k,)
        if not len(at):
            return []
        breaks = np.flatnonzero(np.diff(at) > STICK)
        starts, ends = at[np.r_[0, breaks + 1]], at[np.r_[breaks, -1]]
        return list(zip(starts.tolist(), ends.tolist(), strict=True))


class Memory:
    """The newest rows of a truth, at least `rows` of them, in bounded space."""

    def __init__(self, rows: int) -> None:
        self._rows, self._filled = rows, 0
        self._time = np.empty(2 * rows, np.int64)
        self._values = np.empty((2 * rows, 5))

    def add(self, truth: Truth) -> None:
        """Remember these rows, and forget the oldest when there is no room."""
        truth = truth[-self._rows :]
        if self._filled + len(truth) > len(self._time):
            kept = slice(self._filled - self._rows, self._filled)
            self._time[: self._rows], self._values[: self._rows] = self._time[kept], self._values[kept]
            self._filled = self._rows
        end = self._filled + len(truth)
        self._time[self._filled : end] = truth.time
        self._values[self._filled : end, 0] = truth.sliding
        self._values[self._filled : end, 1] = truth.force
        self._values[self._filled : end, 2:] = truth.velocity
        self._filled = end

    def clear(self) -> None:
        """Forget everything."""
        self._filled = 0

    def recall(self, origin: int) -> Truth:
        """All that is remembered, stamped from `origin` (ns)."""
        values = self._values[: self._filled].copy()
        return Truth(self._time[: self._filled] + origin, values[:, 0], values[:, 1], values[:, 2:])

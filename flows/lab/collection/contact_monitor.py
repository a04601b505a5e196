"""What fingertips feel while an arm is driven: whether they are there, and whether a stroke touches them."""

from typing import Final

import numpy as np

from operators.batch import Reals, Touch
from operators.ports import Run, Sink

LEAST: Final = 2.0  # counts, that the mean of a cell has to move by: 0.25 kPa


class Felt(Sink[Touch]):
    """Keeps when each fingertip gave its newest valid reading, and the mean of its counts since `begin`.

    Attributes:
        newest: When each fingertip was felt last, ns, by finger.
    """

    lossless = False

    def __init__(self) -> None:
        self.newest = dict[int, int]()
        self._sums, self._counted = dict[int, Reals](), dict[int, Reals]()  # (6,) each
        self._air = dict[int, Reals]()  # (6,) counts

    @property
    def destination(self) -> str:
        """Its name among the sinks of a flow; nothing is written anywhere."""
        return "what was felt"

    async def open(self, run: Run) -> None:
        """Begin anew."""
        del run
        self.newest.clear()
        self._air.clear()
        self.begin()

    async def write(self, batch: Touch) -> None:
        """Note when each fingertip was felt, and add the counts to the means."""
        if batch.valid[-1].any():
            self.newest[batch.finger] = int(batch.time[-1])
        counts = np.where(batch.valid, batch.counts, 0).sum(axis=0, dtype=np.float64)  # (6,)
        self._sums[batch.finger] = self._sums.get(batch.finger, np.zeros(6)) + counts
        self._counted[batch.finger] = self._counted.get(batch.finger, np.zeros(6)) + batch.valid.sum(axis=0)

    def begin(self) -> None:
        """Take the mean of what comes from now on."""
        self._sums.clear()
        self._counted.clear()

    def air(self) -> None:
        """What came since `begin` is what nothing touched feels like."""
        self._air = self._means()

    def untouched(self) -> list[int]:
        """The fingertips that felt the same since `begin` as in the air; not those that gave no reading."""
        unknown = np.full(6, np.nan)
        moved = {f: np.abs(mean - self._air.get(f, unknown)) for f, mean in self._means().items()}  # (6,)
        return sorted(f for f, each in moved.items() if not (np.isnan(each).all() or (each >= LEAST).any()))

    def _means(self) -> dict[int, Reals]:
        """Of each cell (6,), by finger; NaN of one without a reading."""
        with np.errstate(invalid="ignore"):
            return {finger: total / self._counted[finger] for finger, total in self._sums.items()}

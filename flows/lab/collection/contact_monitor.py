"""Monitor of the fingertips while an arm moves: newest samples, and contact during a stroke."""

from typing import Final

import numpy as np

from operators.batch import Reals, Touch
from operators.ports import Run, Sink

LEAST_CHANGE: Final = 2.0  # counts (0.25 kPa); contact changes a cell's mean by at least this much


class ContactMonitor(Sink[Touch]):
    """Sink that keeps the time of each fingertip's newest valid sample, and the means of its counts.

    Attributes:
        newest: Time of the newest valid sample, ns, by finger.
    """

    lossless = False

    def __init__(self) -> None:
        self.newest = dict[int, int]()
        self._sums = dict[int, Reals]()  # (2, 6) sums of counts and numbers of valid samples, by finger
        self._baseline = dict[int, Reals]()  # (6,) counts, by finger

    @property
    def destination(self) -> str:
        """Name among the sinks of a flow; nothing is written."""
        return "contact monitor"

    async def open(self, run: Run) -> None:
        """Reset the newest times, the means and the baseline."""
        del run
        self.newest.clear()
        self._baseline.clear()
        self.restart()

    def take(self, batch: Touch) -> bool:
        """Store the time of the newest valid sample, and add the counts to the means."""
        if batch.valid[-1].any():
            self.newest[batch.finger] = int(batch.time[-1])
        more = np.stack([batch.counts * batch.valid, batch.valid]).sum(axis=1, dtype=np.float64)
        self._sums[batch.finger] = self._sums.get(batch.finger, np.zeros((2, 6))) + more
        return True

    def restart(self) -> None:
        """Reset the means."""
        self._sums.clear()

    def set_baseline(self) -> None:
        """Store the current means as the baseline without contact."""
        self._baseline = self._means()

    def without_contact(self) -> list[int]:
        """Return the fingertips whose means do not differ from the baseline; omit those without samples."""
        unknown = np.full(6, np.nan)
        change = {f: np.abs(mean - self._baseline.get(f, unknown)) for f, mean in self._means().items()}
        return sorted(
            finger
            for finger, cells in change.items()  # (6,)
            if not (np.isnan(cells).all() or (cells >= LEAST_CHANGE).any())
        )

    def _means(self) -> dict[int, Reals]:
        """Return the mean of each cell (6,), by finger; NaN without samples."""
        with np.errstate(invalid="ignore"):
            return {finger: total / number for finger, (total, number) in self._sums.items()}

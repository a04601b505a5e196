"""Counts relative to the unloaded fingertip."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import BAROMETERS, Counts, Flags, Touch, Zeroed, maker
from operators.errors import ParameterError
from operators.operator import Operator
from operators.tail import Tail

_FULL: Final = 1023  # counts, of the 10-bit converter
_made: Final = maker(Zeroed)


@dataclass
class Zero(Operator[Touch, Zeroed]):
    """Subtract the baseline: what each barometer reads while nothing touches the fingertip.

    When it is not given it is measured, as in TakkTile's own code: the median of a cell's valid counts in
    the first `scans` scans, rounded half to even. Those scans are held back until it is known. A cell that
    never answered in them has no baseline and stays invalid. What is zeroed already passes unchanged.

    Raises:
        ParameterError: on a baseline that no cell reads, or too few `scans`.
    """

    baseline: int | tuple[int, ...] | None = None  # raw ADC counts, of all cells or of each; None: measured
    scans: int = 100
    _offset: Counts | None = field(default=None, init=False, repr=False, compare=False)  # (1, 6)
    _known: Flags | None = field(default=None, init=False, repr=False, compare=False)  # (6,); None: all are
    _held: Tail[Touch] = field(default_factory=lambda: Tail(Touch), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.scans < 1:
            raise ParameterError("Zero", "scans", self.scans, "at least 1 sample")
        if self.baseline is not None:
            cells = (self.baseline,) * BAROMETERS if isinstance(self.baseline, int) else self.baseline
            if len(cells) != BAROMETERS or not all(0 <= cell <= _FULL for cell in cells):
                raise ParameterError("Zero", "baseline", self.baseline, f"one or six counts, 0 to {_FULL}")
            self._offset = np.array([cells], np.int16)

    def process(self, batch: Touch) -> Zeroed:
        """Give the batch with the baseline subtracted, or hold it back."""
        if isinstance(batch, Zeroed):
            return batch
        if self._offset is not None:
            return self._subtract(batch, self._offset)
        self._held.append(batch)
        return self._release() if len(self._held) >= self.scans else Zeroed.empty()

    def flush(self) -> Zeroed:
        """Give what is held back, with the baseline that it shows."""
        return self._release() if len(self._held) else Zeroed.empty()

    def _release(self) -> Zeroed:
        held, self._held = self._held.rows, Tail(Touch)
        first = held[: self.scans]
        known = np.any(first.valid, axis=0)  # (6,)
        self._known = None if np.all(known) else known
        self._offset = np.zeros((1, BAROMETERS), np.int16)
        for cell in np.flatnonzero(known):
            self._offset[0, cell] = np.rint(np.median(first.counts[first.valid[:, cell], cell]))
        return self._subtract(held, self._offset)

    def _subtract(self, batch: Touch, offset: Counts) -> Zeroed:
        valid = batch.valid if self._known is None else batch.valid & self._known
        return _made(batch.time, batch.counts - offset, batch.temperature, valid, batch.finger)

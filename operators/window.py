"""Sliding windows of samples, without copies."""

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.batch import Counts, Flags, Touch, Windows
from operators.checks import check_whole
from operators.operator import Operator

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass
class Window(Operator[Touch, Windows]):
    """Collect the newest `length` samples at every `hop`-th sample, starting with the first full window.

    Windows are read-only views that overlap in memory; the memory is never overwritten, so they may be kept.

    Args:
        length: Length of a window, samples.
        hop: Distance between windows, samples.

    Raises:
        ParameterError: if `length` or `hop` is below 1.

    >>> cells = np.zeros((5, 6), np.int16)
    >>> touch = Touch(np.arange(5), cells, cells, cells == 0)
    >>> Window(length=3, hop=2).push(touch).counts.shape
    (2, 3, 6)
    """

    length: int = 100
    hop: int = 1
    # counts and valid of the newest rows, which the next windows need
    _kept: tuple[Counts, Flags] | None = field(default=None, init=False, repr=False, compare=False)
    _due: int = field(default=0, init=False, repr=False)  # samples until the next window is complete

    def __post_init__(self) -> None:
        check_whole("Window", "length", self.length, 1, "sample")
        check_whole("Window", "hop", self.hop, 1, "sample")
        self._due = self.length

    def process(self, batch: Touch) -> Windows:
        """Return the windows whose newest sample is in the batch."""
        older = self._kept or (batch.counts[:0], batch.valid[:0])
        counts, valid = np.concatenate((older[0], batch.counts)), np.concatenate((older[1], batch.valid))
        size, due, hop, windows = len(batch), self._due, self.hop, Windows.empty()
        self._due -= size
        if size >= due:
            count = (size - due) // hop + 1
            first = len(counts) - size + due - self.length  # oldest row of the first window
            views = self._overlapping(counts, first, count), self._overlapping(valid, first, count)
            windows = Windows(batch.time[due - 1 :: hop], *views, finger=batch.finger)
            self._due += count * hop
        spare = len(counts) - max(self.length - self._due, 0)
        self._kept = counts[spare:], valid[spare:]
        return windows

    def _overlapping(self, rows: NDArray[Scalar], first: int, count: int) -> NDArray[Scalar]:
        # (count, length, cells), ten times as fast as sliding_window_view
        row, item = rows.strides
        shape = count, self.length, rows.shape[1]
        windows = np.ndarray(shape, rows.dtype, rows, first * row, (self.hop * row, row, item))
        windows.flags.writeable = False
        return windows

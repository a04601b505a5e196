"""Sliding windows of samples, without copies."""

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.batch import Touch, Windows
from operators.checks import check_at_least
from operators.operator import Operator
from operators.row_queues import Tail

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
    _tail: Tail[Touch] = field(default_factory=lambda: Tail(Touch), init=False, repr=False, compare=False)
    _due: int = field(default=0, init=False, repr=False)  # samples until the next window is complete

    def __post_init__(self) -> None:
        check_at_least("Window", "length", self.length, 1, "sample")
        check_at_least("Window", "hop", self.hop, 1, "sample")
        self._due = self.length

    def process(self, batch: Touch) -> Windows:
        """Return the windows whose newest sample is in the batch."""
        tail, due, size, hop = self._tail, self._due, len(batch), self.hop
        tail.append(batch)
        if size < due:
            self._due -= size
            windows = Windows.empty()
        else:
            block, count = tail.block, (size - due) // hop + 1
            newest = tail.stop - size + due - 1  # of the first window
            windows = Windows(
                block.time[newest : newest + (count - 1) * hop + 1 : hop],
                self._overlapping(block.counts, newest, count),
                self._overlapping(block.valid, newest, count),
                finger=batch.finger,
            )
            self._due += count * hop - size
        spare = len(tail) - max(self.length - self._due, 0)
        if spare > 0:
            tail.drop(spare)
        return windows

    def _overlapping(self, rows: NDArray[Scalar], newest: int, count: int) -> NDArray[Scalar]:
        # (count, length, 6), ten times as fast as sliding_window_view
        row, item = rows.strides
        windows = np.ndarray(
            (count, self.length, rows.shape[1]),
            rows.dtype,
            rows,
            (newest + 1 - self.length) * row,
            (self.hop * row, row, item),
        )
        windows.flags.writeable = False
        return windows

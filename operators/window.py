"""The samples up to each instant, without copying them."""

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, Touch, Windows
from operators.errors import ParameterError
from operators.operator import Operator
from operators.tail import Tail

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass
class Window(Operator[Touch, Windows]):
    """The newest `length` samples at every `hop`-th sample, once there are as many.

    Windows overlap in memory and are read-only; that memory is never written again, so they may be kept.

    Raises:
        ParameterError: if `length` or `hop` is no number of samples.
    """

    length: int = 100  # samples
    hop: int = 1  # samples
    _tail: Tail[Touch] = field(default_factory=lambda: Tail(Touch), init=False, repr=False, compare=False)
    _due: int = field(default=0, init=False, repr=False)  # samples until the next window is complete

    def __post_init__(self) -> None:
        for name in ("length", "hop"):
            if getattr(self, name) < 1:
                raise ParameterError("Window", name, getattr(self, name), "at least 1 sample")
        self._due = self.length

    def process(self, batch: Touch) -> Windows:
        """Give the windows whose newest sample is in the batch."""
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
        # what sliding_window_view gives, in a tenth of the time; (count, length, 6)
        row, item = rows.strides
        windows = np.ndarray(
            (count, self.length, BAROMETERS),
            rows.dtype,
            rows,
            (newest + 1 - self.length) * row,
            (self.hop * row, row, item),
        )
        windows.flags.writeable = False
        return windows

"""Queue of a stream's rows in one block of memory."""

from typing import Any, Final, Generic

import numpy as np

from operators.batch import AnyBatch, Times, layout

_ROWS: Final = 1024  # smallest size of a block


class Tail(Generic[AnyBatch]):
    """Queue of rows: appended at the end, dropped at the front.

    When the block is full, its rows are copied to a new block; nothing is ever overwritten, so views remain
    valid. Memory is bounded by the rows in use and the largest batch.

    Attributes:
        block: Memory; the rows from `start` to `stop` are in use.
        start: Index of the oldest row.
        stop: Index after the newest row.

    >>> from operators.batch import Batch
    >>> tail = Tail(Batch)
    >>> tail.append(Batch(np.array([1, 2, 3])))
    >>> tail.drop(1)
    >>> tail.rows.time
    array([2, 3])
    """

    block: AnyBatch
    start: int
    stop: int

    def __init__(self, kind: type[AnyBatch]) -> None:
        self._use(kind.empty())

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def time(self) -> Times:
        """Time of the rows, as a view."""
        return self.block.time[self.start : self.stop]

    @property
    def rows(self) -> AnyBatch:
        """Rows in use, as views."""
        return self.block[self.start : self.stop]

    def append(self, batch: AnyBatch) -> None:
        """Append copies of rows; columns that the type lacks are dropped."""
        stop = self.stop + batch.time.size
        if stop > self._size or batch.finger != self._finger:
            self._move(batch)
            stop = self.stop + batch.time.size
        for column, values in zip(self._take(self.block), self._take(batch), strict=True):
            column[self.stop : stop] = values
        self.stop = stop

    def drop(self, count: int) -> None:
        """Drop the oldest `count` rows."""
        self.start += count

    def _move(self, batch: AnyBatch) -> None:
        """Move the rows in use to a new block with room for a batch, which determines the shape of a row."""
        kept, count = self._take(self.rows), len(self)
        size = max(_ROWS, 2 * count + batch.time.size)
        arrays: list[Any] = [np.empty((size, *new.shape[1:]), new.dtype) for new in self._take(batch)]
        if count:
            for array, column in zip(arrays, kept, strict=True):
                array[:count] = column
        self._use(type(self.block)(*arrays, finger=batch.finger))
        self.stop = count

    def _use(self, block: AnyBatch) -> None:
        self.block, self.start, self.stop = block, 0, 0
        self._size, self._finger = len(block), block.finger
        self._take = layout(type(block)).take

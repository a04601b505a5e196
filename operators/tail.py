"""The newest rows of a stream, kept in memory taken beforehand."""

from typing import Any, Final, Generic

import numpy as np
from numpy.typing import NDArray

from operators.batch import AnyBatch, Times, layout

_ROWS: Final = 1024  # of a block, at least


class Tail(Generic[AnyBatch]):
    """Rows appended one behind the other and dropped from the front.

    When the block is full, the rows still kept move to a new one; nothing is ever written over. So what was
    given out as a view stays true, and memory is bounded by the rows kept and the largest batch appended.
    A pickle holds the kept rows only.

    Attributes:
        block: the memory, of which the rows from `start` to `stop` are in use.
        start: the oldest row kept.
        stop: one past the newest row.

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
    _cells: list[NDArray[Any]]  # the block's columns, each row with a length: the fastest to set one of

    def __init__(self, kind: type[AnyBatch]) -> None:
        self.__setstate__(kind.empty())

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def time(self) -> Times:
        """The time of the rows kept, as a view."""
        return self.block.time[self.start : self.stop]

    @property
    def rows(self) -> AnyBatch:
        """The rows kept, as views."""
        return self.block[self.start : self.stop]

    def append(self, batch: AnyBatch) -> None:
        """Copy rows behind those kept; columns that the kind lacks fall away."""
        size = batch.time.size
        if self.stop + size > self._size or self._finger != batch.finger:
            self._renew(batch)
        stop = self.stop + size
        if size == 1:
            for cells, values in zip(self._cells, self._take(batch), strict=True):
                cells[self.stop] = values
        else:
            for column, values in zip(self._take(self.block), self._take(batch), strict=True):
                column[self.stop : stop] = values
        self.stop = stop

    def drop(self, count: int) -> None:
        """Forget the oldest `count` rows."""
        self.start += count

    def _renew(self, batch: AnyBatch) -> None:
        kept = len(self)
        size = max(_ROWS, 2 * kept + len(batch))
        columns = self._take(self.block)
        arrays: list[Any] = [np.empty((size, *old.shape[1:]), old.dtype) for old in columns]
        for array, column in zip(arrays, columns, strict=True):
            array[:kept] = column[self.start : self.stop]
        self.__setstate__(type(self.block)(*arrays, finger=batch.finger))
        self.stop = kept

    def __getstate__(self) -> AnyBatch:
        return self.rows

    def __setstate__(self, rows: AnyBatch) -> None:
        self.block, self.start, self.stop = rows, 0, len(rows)
        self._size, self._finger = len(rows), rows.finger  # of the block
        self._take = layout(type(rows)).take
        columns = self._take(rows)
        self._cells = [column if column.ndim > 1 else column[:, None] for column in columns]

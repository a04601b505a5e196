"""The newest rows of a stream, kept in memory taken beforehand."""

from typing import Any, Final, Generic

import numpy as np
from numpy.typing import NDArray

from operators.batch import AnyBatch, Times, columns

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
    _columns: list[tuple[str, NDArray[Any]]]

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
        stop = self.stop + size
        if stop > self.block.time.size or self.block.finger != batch.finger:
            self._renew(batch)
            stop = self.stop + size
        if size == 1:
            for name, column in self._columns:
                column[self.stop] = getattr(batch, name)[0]
        else:
            for name, column in self._columns:
                column[self.stop : stop] = getattr(batch, name)
        self.stop = stop

    def drop(self, count: int) -> None:
        """Forget the oldest `count` rows."""
        self.start += count

    def _renew(self, batch: AnyBatch) -> None:
        kept = len(self)
        size = max(_ROWS, 2 * kept + len(batch))
        arrays: list[Any] = [np.empty((size, *old.shape[1:]), old.dtype) for _, old in self._columns]
        for array, (_, column) in zip(arrays, self._columns, strict=True):
            array[:kept] = column[self.start : self.stop]
        self.__setstate__(type(self.block)(*arrays, finger=batch.finger))
        self.stop = kept

    def __getstate__(self) -> AnyBatch:
        return self.rows

    def __setstate__(self, rows: AnyBatch) -> None:
        self.block, self.start, self.stop = rows, 0, len(rows)
        self._columns = [(name, getattr(rows, name)) for name in columns(type(rows))]

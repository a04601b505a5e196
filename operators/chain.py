"""Rows of a stream, stored in their original batches."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from typing import Generic

from operators.batch import AnyBatch, concat


class Chain(Generic[AnyBatch]):
    """Queue of the rows of one fingertip, ordered by time.

    Batches are stored and returned without copying where possible. A pickle holds the rows as one batch.

    >>> import numpy as np
    >>> from operators.batch import Batch
    >>> chain = Chain(Batch)
    >>> chain.append(Batch(np.array([1, 2, 3])))
    >>> chain.take(before=3).time, chain.take(before=3)
    (array([1, 2]), None)
    """

    def __init__(self, kind: type[AnyBatch], batches: Iterable[AnyBatch] = ()) -> None:
        self._kind, self._batches = kind, list(batches)
        self._newest = [batch.time.item(-1) for batch in self._batches]  # ns, newest row of each batch

    def append(self, batch: AnyBatch) -> None:
        """Append a batch of at least one row, none older than the rows before."""
        self._batches.append(batch)
        self._newest.append(batch.time.item(-1))

    def take(self, before: int) -> AnyBatch | None:
        """Remove and return the rows older than `before` (ns); None if there are none."""
        if not self._batches or self._batches[0].time.item(0) >= before:
            return None
        taken = self._cut(before)
        return taken[0] if len(taken) == 1 else concat(self._kind, taken)

    def forget(self, before: int, slack: int = 0) -> None:
        """Remove the rows older than `before` (ns), if the oldest is more than `slack` (ns) older."""
        if self._batches and self._batches[0].time.item(0) < before - slack:
            self._cut(before)

    def around(self, time: int) -> tuple[AnyBatch | None, AnyBatch | None]:
        """Return the last row up to a time (ns) and the first one after it; None if there is none."""
        batches, index = self._batches, bisect_right(self._newest, time)
        before = batches[index - 1] if index else None
        after = batches[index] if index < len(batches) else None
        if after is not None and after.time.size > 1:
            row = int(after.time.searchsorted(time, "right"))
            if row:
                return after[row - 1 : row], after[row : row + 1]
            after = after[:1]
        return (before if before is None or before.time.size == 1 else before[-1:]), after

    def over(self, first: int, last: int) -> AnyBatch:
        """Return the batches with the rows from `first` to `last` (ns) and with a neighbour on each side."""
        start, stop = bisect_right(self._newest, first), bisect_right(self._newest, last)
        return concat(self._kind, self._batches[max(start - 1, 0) : stop + 1])

    def _cut(self, before: int) -> list[AnyBatch]:
        batches, count = self._batches, bisect_left(self._newest, before)
        taken = batches[:count]
        if count < len(batches) and (row := int(batches[count].time.searchsorted(before))):
            taken.append(batches[count][:row])
            batches[count] = batches[count][row:]
        del batches[:count], self._newest[:count]
        return taken

    def __reduce__(self) -> tuple[type["Chain[AnyBatch]"], tuple[type[AnyBatch], list[AnyBatch]]]:
        return type(self), (self._kind, [concat(self._kind, self._batches)] if self._batches else [])

"""Rows of a stream, kept in the batches that they came in."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from typing import Generic

from operators.batch import AnyBatch, concat


class Chain(Generic[AnyBatch]):
    """Rows of one fingertip in order of time, appended behind and taken from the front.

    Batches are kept and given out as they are: one row at a time, nothing is copied. A pickle holds the
    rows as one batch.

    >>> import numpy as np
    >>> from operators.batch import Batch
    >>> chain = Chain(Batch)
    >>> chain.append(Batch(np.array([1, 2, 3])))
    >>> chain.take(before=3).time, chain.take(before=3)
    (array([1, 2]), None)
    """

    def __init__(self, kind: type[AnyBatch], batches: Iterable[AnyBatch] = ()) -> None:
        self._kind, self._batches = kind, list(batches)
        self._newest = [batch.time.item(-1) for batch in self._batches]  # ns, of each batch

    def append(self, batch: AnyBatch) -> None:
        """Keep at least one row more, none older than those kept."""
        self._batches.append(batch)
        self._newest.append(batch.time.item(-1))

    def take(self, before: int) -> AnyBatch | None:
        """Give up the rows older than `before` (ns); None if there are none."""
        if not self._batches or self._batches[0].time.item(0) >= before:
            return None
        taken = self._cut(before)
        return taken[0] if len(taken) == 1 else concat(self._kind, taken)

    def forget(self, before: int, slack: int = 0) -> None:
        """Give up the rows older than `before` (ns), if one of them is older by more than `slack` (ns)."""
        if self._batches and self._batches[0].time.item(0) < before - slack:
            self._cut(before)

    def around(self, time: int) -> tuple[AnyBatch | None, AnyBatch | None]:
        """The last row up to an instant (ns) and the first after it, each None if there is none."""
        batches, place = self._batches, bisect_right(self._newest, time)
        before = batches[place - 1] if place else None
        after = batches[place] if place < len(batches) else None
        if after is not None and after.time.size > 1:
            row = int(after.time.searchsorted(time, "right"))
            if row:
                return after[row - 1 : row], after[row : row + 1]
            after = after[:1]
        return (before if before is None or before.time.size == 1 else before[-1:]), after

    def over(self, first: int, last: int) -> AnyBatch:
        """The rows from the last up to `first` (ns) to the first after `last`, and maybe some more."""
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

"""Rows of a stream, stored in their original batches."""

from collections import deque
from typing import Final, Generic

from operators.batch import AnyBatch, concat

END: Final = 2**62  # ns, later than any stamp


class Chain(Generic[AnyBatch]):
    """Queue of the rows of one fingertip, ordered by time.

    Batches are stored and returned without copying where possible. A pickle holds the rows as one batch.

    >>> import numpy as np
    >>> from operators.batch import Batch
    >>> chain = Chain(Batch)
    >>> chain.append(Batch(np.array([1, 2, 3])))
    >>> chain.take(before=3).time, len(chain)
    (array([1, 2]), 1)
    """

    def __init__(self, kind: type[AnyBatch], *batches: AnyBatch) -> None:
        self._kind, self._batches, self._empty = kind, deque(batches), kind.empty()

    def __len__(self) -> int:
        return sum(map(len, self._batches))

    def append(self, batch: AnyBatch) -> None:
        """Append a batch of at least one row, none older than the previous rows."""
        self._batches.append(batch)

    def take(self, before: int = END) -> AnyBatch:
        """Remove and return the rows older than `before` (ns)."""
        batches = self._batches
        if not batches or batches[0].time.item(0) >= before:
            return self._empty
        taken: list[AnyBatch] = []
        while batches and batches[0].time.item(-1) < before:
            taken.append(batches.popleft())
        if batches and batches[0].time.item(0) < before:
            row = int(batches[0].time.searchsorted(before))
            taken.append(batches[0][:row])
            batches[0] = batches[0][row:]
        return taken[0] if len(taken) == 1 else concat(self._kind, taken)

    def __reduce__(self) -> tuple[type["Chain[AnyBatch]"], tuple[object, ...]]:
        return type(self), (self._kind, concat(self._kind, self._batches)) if self._batches else (self._kind,)

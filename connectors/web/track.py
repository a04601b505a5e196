"""The newest rows of one stream, thinned to what an eye can follow."""

from typing import Final, Generic

import numpy as np

from operators.batch import AnyBatch, Flags, Times, ms, s
from operators.tail import Tail

SPAN: Final = 30 * s  # ns, that is kept
STEP: Final = 5 * ms  # ns, of which one row is kept


class Track(Generic[AnyBatch]):
    """Keeps the last 30 s of a stream, the first row of each 5 ms: 6,000 rows at most.

    Rows older than one that came before are left out.
    """

    def __init__(self, kind: type[AnyBatch]) -> None:
        self._tail = Tail(kind)
        self._step = int(np.iinfo(np.int64).min)  # in which the newest row lies
        self._fresh = 0  # rows that `take` has not given

    def add(self, batch: AnyBatch) -> None:
        """Append the rows of a batch; whatever finger it has, it must be that of the others."""
        kept = batch[self._first_of_steps(batch.time)] if len(batch) > 1 else batch
        if not len(kept):
            return
        newest: int = kept.time.item(-1)
        if newest // STEP <= self._step:
            return
        self._step = newest // STEP
        self._tail.append(kept)
        self._tail.drop(int(np.searchsorted(self._tail.time, newest - SPAN)))
        self._fresh = min(self._fresh + len(kept), len(self._tail))

    @property
    def rows(self) -> AnyBatch:
        """All that is kept, as views that stay true."""
        return self._tail.rows

    def take(self) -> AnyBatch | None:
        """The rows that came since this was called last, as views that stay true; None: there are none."""
        if not self._fresh:
            return None
        fresh, self._fresh = self._fresh, 0
        return self._tail.rows[-fresh:]

    def _first_of_steps(self, time: Times) -> Flags:
        """Which rows are the first of a later step than all before them; (n,)."""
        steps: Times = time // STEP
        before: Times = np.maximum.accumulate(np.append(np.int64(self._step), steps[:-1]))
        return steps > before

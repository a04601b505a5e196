"""Rows with values that follow from their number, so that rows read from disk can be checked."""

from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from itertools import count
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators import Clock, Motion, Source, Touch, s
from operators.batch import BAROMETERS, Batch, Times
from tests.storage.made import same

SomeBatch = TypeVar("SomeBatch", bound=Batch)
Numbers = NDArray[np.int64]

CELLS = np.arange(BAROMETERS)
SLOW_ROWS = 40  # rows in which the arm's speed rises once from 0 to 1 cm/s


def touch(numbers: Numbers, time: Times) -> Touch:
    """Return the touch rows with these numbers (n,) and times (n,)."""
    six = numbers[:, None] * 7 + CELLS * 131  # (n, 6)
    warm = (numbers[:, None] + CELLS) % 30_011
    return Touch(time, (six % 1024).astype(np.int16), warm.astype(np.int16), six % 11 > 0, finger=0)


def motion(numbers: Numbers, time: Times) -> Motion:
    """Return the motion rows with these numbers (n,) and times (n,)."""
    six = numbers[:, None] % SLOW_ROWS / SLOW_ROWS / 100 + CELLS / 1e6  # (n, 6)
    return Motion(time, numbers, six, numbers[:, None] / 8 + CELLS)


class Numbered(Source[SomeBatch], Generic[SomeBatch]):
    """Endless source of rows 0, 1, 2..., one per batch, stamped with the time when each is due."""

    def __init__(
        self,
        kind: type[SomeBatch],
        make: Callable[[Numbers, Times], SomeBatch],
        rate: float,
        produced: Callable[[int], None] = lambda _: None,
        fingers: tuple[int, ...] = (0,),
    ) -> None:
        """Produce `rate` rows per second; call `produced` with the number of rows just before each row."""
        self._kind, self._make, self._rate = kind, make, rate
        self._produced, self._fingers = produced, fingers

    @property
    def kind(self) -> type[SomeBatch]:
        """Type of the batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertips of the batches."""
        return self._fingers

    async def batches(self, clock: Clock) -> AsyncIterator[SomeBatch]:
        """Yield rows without end."""
        origin = clock.now()
        for number in count():
            due = origin + round(number * s / self._rate)
            await clock.sleep_until(due)
            self._produced(number + 1)
            yield self._make(np.array([number]), np.array([due]))


def prefix(found: SomeBatch, make: Callable[[Numbers, Times], SomeBatch], rate: float) -> bool:
    """Return True if these are the first rows of a `Numbered` source, complete and correct."""
    if not len(found):
        return True
    numbers = np.arange(len(found))
    due = [round(number * s / rate) for number in range(len(found))]
    with suppress(AssertionError):
        same(found, make(numbers, found.time[0] + np.array(due, np.int64)))
        return True
    return False

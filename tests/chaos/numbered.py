"""Rows that tell their number: what is read again can be held against what was given, value by value."""

from collections.abc import AsyncIterator, Callable
from itertools import count
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators import Clock, Motion, Source, Touch, s
from operators.batch import BAROMETERS, Batch, Times, columns

Given = TypeVar("Given", bound=Batch)
Numbers = NDArray[np.int64]

CELLS = np.arange(BAROMETERS)
SLOW_ROWS = 40  # in which the arm's speed rises once from 0 to 1 cm/s


def touch(numbers: Numbers, time: Times) -> Touch:
    """Rows of these numbers, (n,), stamped with `time`, (n,)."""
    six = numbers[:, None] * 7 + CELLS * 131  # (n, 6)
    warm = (numbers[:, None] + CELLS) % 30_011
    return Touch(time, (six % 1024).astype(np.int16), warm.astype(np.int16), six % 11 > 0, finger=0)


def motion(numbers: Numbers, time: Times) -> Motion:
    """The same of the arm."""
    six = numbers[:, None] % SLOW_ROWS / SLOW_ROWS / 100 + CELLS / 1e6  # (n, 6)
    return Motion(time, numbers, six, numbers[:, None] / 8 + CELLS)


class Numbered(Source[Given], Generic[Given]):
    """Gives rows 0, 1, 2... one at a time, stamped with the instant at which each is due."""

    def __init__(
        self,
        kind: type[Given],
        make: Callable[[Numbers, Times], Given],
        rate: float,
        given: Callable[[int], None] = lambda _: None,
        fingers: tuple[int, ...] = (0,),
    ) -> None:
        """Give `rate` rows a second; `given` is told how many there are, just before the newest is out."""
        self._kind, self._make, self._rate, self._given, self._fingers = kind, make, rate, given, fingers

    @property
    def kind(self) -> type[Given]:
        """As it was made."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """One fingertip, or the arm."""
        return self._fingers

    async def batches(self, clock: Clock) -> AsyncIterator[Given]:
        """For ever."""
        origin = clock.now()
        for number in count():
            due = origin + round(number * s / self._rate)
            await clock.sleep_until(due)
            self._given(number + 1)
            yield self._make(np.array([number]), np.array([due]))


def alike(left: Batch, right: Batch) -> bool:
    """Whether two batches are the same to the last bit."""
    if type(left) is not type(right) or left.finger != right.finger:
        return False
    pairs = ((getattr(left, name), getattr(right, name)) for name in columns(type(left)))
    return all((a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()) for a, b in pairs)


def prefix(found: Given, make: Callable[[Numbers, Times], Given], rate: float) -> bool:
    """Whether these are the first rows that a `Numbered` gave, none missing and each of them right."""
    if not len(found):
        return True
    numbers = np.arange(len(found))
    due = [round(number * s / rate) for number in range(len(found))]
    return alike(found, make(numbers, found.time[0] + np.array(due, np.int64)))

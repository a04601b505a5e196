"""A fingertip and an arm that cost nothing and never end, and slip at every sample."""

from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import numpy as np

from operators import SLIP, STATIC, Clock, Motion, Operator, Slips, Source, Touch, Zeroed, s

CHANCE = np.random.default_rng(0)
TABLE = CHANCE.integers(500, 520, (1000, 6)).astype(np.int16)  # counts, each row one scan
ALL = np.ones((1, 6), bool)


class Fingertip(Source[Touch]):
    """Gives one row at a time, stamped as it is given."""

    def __init__(self, rate: float) -> None:
        """Give `rate` rows a second."""
        self._rate = rate

    @property
    def kind(self) -> type[Touch]:
        """Touch."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """One fingertip."""
        return (0,)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """For ever."""
        async for number in ticks(clock, self._rate):
            counts = TABLE[number % len(TABLE)][None]  # (1, 6)
            yield Touch(np.array([clock.now()]), counts, counts, ALL, finger=0)


class Arm(Source[Motion]):
    """Gives one row at a time, stamped as it is given."""

    def __init__(self, rate: float) -> None:
        """Give `rate` rows a second."""
        self._rate = rate

    @property
    def kind(self) -> type[Motion]:
        """Motion."""
        return Motion

    async def batches(self, clock: Clock) -> AsyncIterator[Motion]:
        """For ever."""
        async for number in ticks(clock, self._rate):
            now, six = np.array([clock.now()]), TABLE[number % len(TABLE)][None] / 1000  # (1, 6)
            yield Motion(now, now, six, six)


@dataclass
class Turning(Operator[Zeroed, Slips]):
    """Onset and end by turns, at every row."""

    _state: int = field(default=STATIC, init=False)

    def process(self, batch: Zeroed) -> Slips:
        """One event a row."""
        states = (self._state + 1 + np.arange(len(batch))) % (SLIP + 1)
        self._state = int(states[-1])
        sure = np.full(len(batch), 0.9)
        return Slips(batch.time, states.astype(np.int8), batch.time, sure, finger=batch.finger)


async def ticks(clock: Clock, rate: float) -> AsyncIterator[int]:
    """Count `rate` times a second; what was missed in a stop is left out."""
    due, number = clock.now(), 0
    while True:
        due = max(due + round(s / rate), clock.now() - s // 10)
        await clock.sleep_until(due)
        yield number
        number += 1

"""Cheap endless sources of touch and motion, and an operator that makes each sample a slip event."""

from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import numpy as np

from operators import SLIP, STATIC, Clock, Motion, Operator, Slips, Source, Touch, Zeroed, s

RNG = np.random.default_rng(0)
TABLE = RNG.integers(500, 520, (1000, 6)).astype(np.int16)  # counts, each row one scan
ALL = np.ones((1, 6), bool)


class Fingertip(Source[Touch]):
    """Endless source of single rows, stamped when they are produced."""

    def __init__(self, rate: float) -> None:
        """Produce `rate` rows per second."""
        self._rate = rate

    @property
    def kind(self) -> type[Touch]:
        """Type of the batches."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertip."""
        return (0,)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield rows without end."""
        async for number in ticks(clock, self._rate):
            counts = TABLE[number % len(TABLE)][None]  # (1, 6)
            yield Touch(np.array([clock.now()]), counts, counts, ALL, finger=0)


class Arm(Source[Motion]):
    """Endless source of single rows, stamped when they are produced."""

    def __init__(self, rate: float) -> None:
        """Produce `rate` rows per second."""
        self._rate = rate

    @property
    def kind(self) -> type[Motion]:
        """Type of the batches."""
        return Motion

    async def batches(self, clock: Clock) -> AsyncIterator[Motion]:
        """Yield rows without end."""
        async for number in ticks(clock, self._rate):
            now, six = np.array([clock.now()]), TABLE[number % len(TABLE)][None] / 1000  # (1, 6)
            yield Motion(now, now, six, six)


@dataclass
class Alternating(Operator[Zeroed, Slips]):
    """Slip event at each row, alternately onset and end."""

    _state: int = field(default=STATIC, init=False)

    def process(self, batch: Zeroed) -> Slips:
        """Return one event for each row."""
        states = (self._state + 1 + np.arange(len(batch))) % (SLIP + 1)
        self._state = int(states[-1])
        probability = np.full(len(batch), 0.9)
        return Slips(batch.time, states.astype(np.int8), batch.time, probability, finger=batch.finger)


async def ticks(clock: Clock, rate: float) -> AsyncIterator[int]:
    """Count `rate` times per second; after a pause of the process the missed counts are skipped."""
    due, number = clock.now(), 0
    while True:
        due = max(due + round(s / rate), clock.now() - s // 10)
        await clock.sleep_until(due)
        yield number
        number += 1

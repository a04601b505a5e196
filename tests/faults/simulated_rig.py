"""Rig and consumer of the simulation: devices with numbered rows, and records of accepted rows and events."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from math import inf
from random import Random

import numpy as np

from connectors import Mqtt
from connectors.events import Event
from operators import Operator, Slips, Touch
from operators.batch import Batch, Faults, ms
from operators.ports import Clock, Source
from storage.dataset import Dataset, Recordable
from tests.faults.simulated_process import current
from tests.inside import inside

FINGERS = (0, 1)
EVENT_EVERY = 5  # rows
PERIOD = 20 * ms
Identity = tuple[str, str, int]  # session, finger, time (ns)
Row = tuple[int, int, int]  # finger, time (ns), value


@dataclass
class RigRun:
    """One run of the rig, from its start to its end, kill or power loss."""

    session: str
    end: str = "running"  # running, orderly, refused, killed, power loss, stuck
    started: float = 0.0  # loop time, s
    ended: float = 0.0  # loop time, s
    rows: dict[str, list[Row]] = field(default_factory=dict[str, list[Row]])  # accepted, by type
    rows_at: dict[str, list[float]] = field(default_factory=dict[str, list[float]])  # loop time (s) of each
    started_events: set[Identity] = field(default_factory=set[Identity])  # handed to the sink
    events: dict[Identity, float] = field(
        default_factory=dict[Identity, float]
    )  # accepted by the sink: loop time, s
    error: str = ""
    dropped: int = 0  # rows that were not recorded, as reported
    not_kept: int = 0  # events that the broker received, as counted by the outbox


class Device(Source[Touch]):
    """Fingertip in virtual time whose rows are numbered; faults make it fail or fall silent."""

    def __init__(self, finger: int, random: Random) -> None:
        self._finger, self._random = finger, random
        self.failing, self.silent_until, self._number = False, 0.0, 0

    @property
    def kind(self) -> type[Touch]:
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        return (self._finger,)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield batches of 1 to 14 rows, most of them short."""
        loop = asyncio.get_running_loop()
        while True:
            rows = self._random.choice((1, 1, 1, 2, 3, 14))
            await asyncio.sleep(rows * PERIOD / 1e9)
            current()
            if self.failing:
                self.failing = False
                raise OSError("the device was unplugged")
            if loop.time() < self.silent_until:
                await self._stay_silent(loop)
                continue
            newest = clock.now()
            numbers = np.arange(self._number, self._number + rows)
            self._number += rows
            time = newest - PERIOD * np.arange(rows - 1, -1, -1)
            counts = np.repeat(numbers[:, None] % 1000, 6, axis=1).astype(np.int16)  # (n, 6)
            yield Touch(time, counts, counts, np.ones(counts.shape, np.bool_), finger=self._finger)

    async def _stay_silent(self, loop: asyncio.AbstractEventLoop) -> None:
        if self.silent_until == inf:
            await loop.create_future()
        await asyncio.sleep(self.silent_until - loop.time())


class EveryFifth(Operator[Touch, Slips]):
    """Slip event at each fifth row, alternately onset and end."""

    def process(self, batch: Touch) -> Slips:
        number = batch.counts[:, 0]
        chosen = number % EVENT_EVERY == 0
        time, number = batch.time[chosen], number[chosen]
        state = (number // EVENT_EVERY % 2 == 0).astype(np.int8)
        return Slips(time, state, time, np.full(len(time), 0.9), finger=batch.finger)


class WatchedDataset(Dataset):
    """Dataset that notes the accepted rows."""

    rig_run: RigRun
    _noted = 0  # batches

    def take(self, batch: Recordable) -> bool:
        taken = super().take(batch)
        if taken:
            self._note(batch)
        return taken

    async def write(self, batch: Recordable) -> None:
        noted = self._noted
        await super().write(batch)
        current()
        if self._noted == noted:  # it went to the journal without `take`
            self._note(batch)

    def _note(self, batch: Recordable) -> None:
        self._noted += 1
        table = type(batch).__name__
        self.rig_run.rows.setdefault(table, []).extend(numbered_rows(batch))
        self.rig_run.rows_at.setdefault(table, []).extend([asyncio.get_running_loop().time()] * len(batch))


class WatchedMqtt(Mqtt):
    """Event sink that notes the accepted events."""

    rig_run: RigRun

    async def write(self, batch: Slips | Faults) -> None:
        new = [(self.rig_run.session, str(batch.finger), time) for time in batch.time.tolist()]
        self.rig_run.started_events |= set(new)
        try:
            await super().write(batch)
        finally:
            self.rig_run.not_kept = inside(self, "_outbox").not_kept
        current()
        self.rig_run.events |= dict.fromkeys(new, asyncio.get_running_loop().time())


def numbered_rows(batch: Batch) -> list[Row]:
    """Return the identities of the rows of a batch."""
    assert isinstance(batch, Touch | Slips), "the flow records nothing else"
    values = batch.counts[:, 0] if isinstance(batch, Touch) else batch.state
    return list(zip([batch.finger] * len(batch), batch.time.tolist(), values.tolist(), strict=True))


def identity(event: Event) -> Identity:
    """Return the identity of an event, independent of its number."""
    return (event.session or "", event.finger, event.time)

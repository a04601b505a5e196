"""Rig and consumer as processes that tests kill: `python -m tests.chaos.children NAME ARGUMENT...`.

record FOLDER COUNTS RATE    Record until killed. COUNTS is a file of four 64-bit numbers: rows of touch and
                             motion that were produced, and that the dataset accepted. Touch has RATE rows
                             per second, motion a quarter more.
publish URL OUTBOX           Publish 100 events per second until SIGTERM. Print a line `event TIME` for each
                             event that must not be lost from then on.
follow URL POSITION LIST     Append time (ns) and identifier of each event to LIST.
"""

import asyncio
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from connectors import Consumer, Mqtt
from flows.graph import Flow
from flows.run.live_runner import LiveRunner
from flows.run.supervision import signals_to
from operators import EVERY, Batch, Faults, Motion, Slips, Touch
from operators.batch import s
from operators.errors import EndpointError
from storage import Dataset
from storage.dataset import Recordable
from tests.chaos.numbered import Numbered, motion, touch
from tests.faults.simulated_rig import EVENT_EVERY, EveryFifth

SESSION: Final = "killed"
KINDS: tuple[type[Batch], ...] = (Touch, Motion)
PRODUCED, ACCEPTED = slice(0, 2), slice(2, 4)  # of the counts
MOTION_FACTOR: Final = 1.25  # rows of motion per row of touch
EVENTS: Final = 100.0  # events/s


class Counted(Dataset):
    """Dataset that counts the rows it accepted."""

    part_span = s // 2  # so that parts are committed

    def __init__(self, path: Path, accepted: NDArray[np.int64]) -> None:
        super().__init__(path)
        self._accepted = accepted

    def take(self, batch: Recordable) -> bool:
        """Take one batch and count it."""
        accepted = super().take(batch)
        if accepted:
            self._accepted[KINDS.index(type(batch))] += len(batch)
        return accepted

    async def write(self, batch: Recordable) -> None:
        """Write one batch and count it."""
        column = KINDS.index(type(batch))
        before = self._accepted[column]
        await super().write(batch)
        self._accepted[column] = before + len(batch)  # `write` does not always call `take`


class ReportingMqtt(Mqtt):
    """Event sink that prints the events that it has accepted, by a write that survives a kill."""

    async def write(self, batch: Slips | Faults) -> None:
        """Publish a batch and print its events."""
        await super().write(batch)
        if isinstance(batch, Slips):
            for each in batch.time.tolist():
                os.write(1, f"event {each}\n".encode())


async def record(folder: str, counts_file: str, rate: str) -> None:
    """Record two streams until killed, and count their rows."""
    counts: NDArray[np.int64] = np.memmap(counts_file, np.int64, "r+")
    sink, count = Counted(Path(folder), counts[ACCEPTED]), counts[PRODUCED].__setitem__
    touched = Numbered(Touch, touch, float(rate), partial(count, 0))
    moved = Numbered(Motion, motion, MOTION_FACTOR * float(rate), partial(count, 1), (EVERY,))
    flow = Flow(SESSION)
    flow.source(touched, "touch").to(sink)
    flow.source(moved, "motion").to(sink)
    await LiveRunner(flow, SESSION).execute()


async def publish(url: str, outbox: str) -> None:
    """Publish events until SIGTERM."""
    flow = Flow("chaos")
    events = flow.source(Numbered(Touch, touch, EVENTS * EVENT_EVERY), "touch") | EveryFifth()
    events.to(ReportingMqtt(url, "chaos", "rig", outbox=outbox, connect_required=False))
    runner = LiveRunner(flow, f"chaos-{time.time_ns()}")
    with signals_to(runner.stop):
        await runner.execute()


async def follow(url: str, position: str, kept: str) -> None:
    """Store events until killed, each before the next is taken; start again if the broker is down."""
    file = os.open(kept, os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    print_line: Callable[[str], object] = partial(print, flush=True)
    while True:
        with suppress(EndpointError):
            async with Consumer(url, since="start", position_file=position, report=print_line) as events:
                print_line("ready")
                async for event in events:
                    os.write(file, f"{event.time} {event.identifier}\n".encode())
        await asyncio.sleep(0.1)


if __name__ == "__main__":
    name, *arguments = sys.argv[1:]
    asyncio.run({"record": record, "publish": publish, "follow": follow}[name](*arguments))  # type: ignore[operator]

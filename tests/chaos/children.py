"""Rig and consumer as processes that tests kill: `python -m tests.chaos.children NAME ARGUMENT...`.

record FOLDER COUNTS RATE    Record until killed. COUNTS is a file of four 64-bit numbers: rows of touch and
                             motion that were produced, and that the dataset accepted. Touch has RATE rows
                             per second, motion a quarter more.
fill FOLDER HOW FULL ROOM    Record on a disk that is full for FULL seconds, then free for ROOM seconds: a
                             small file system (HOW is tmpfs), or files may not grow (HOW is limit). Print a
                             JSON object.
publish URL OUTBOX           Publish an event for each touch row until SIGTERM. Print a line `event TIME` for
                             each event that must not be lost from then on.
follow URL POSITION LIST     Append time (ns) and identifier of each event to LIST.
"""

import asyncio
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from connectors import Consumer, Mqtt
from connectors.mqtt.mqtt_sink import health
from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.run.live_runner import LiveRunner
from flows.run.supervision import signals_to
from operators import EVERY, SLIP, STATIC, Batch, Faults, Motion, Operator, Slips, Touch, Zero, Zeroed
from operators.batch import ms, s
from operators.errors import EndpointError
from storage import Dataset
from storage.dataset import Recordable
from tests.chaos.numbered import Numbered, motion, touch

SESSION: Final = "killed"
KINDS: tuple[type[Batch], ...] = (Touch, Motion)
PRODUCED, ACCEPTED = slice(0, 2), slice(2, 4)  # of the counts
MOTION_FACTOR: Final = 1.25  # rows of motion per row of touch
RATE: Final = 400.0  # rows/s of touch on a disk that becomes full
FILLER: Final = "filler"
NAME: Final = "datasetoffew"  # of its recorder in health
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


class DatasetOfFew(Dataset):
    """Dataset with a short queue, so that rows are dropped."""

    capacity = 200  # batches


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


class ReportingMqtt(Mqtt):
    """Event sink that prints the events that it has accepted, by a write that survives a kill."""

    async def write(self, batch: Slips | Faults) -> None:
        """Publish a batch and print its events."""
        await super().write(batch)
        if isinstance(batch, Slips):
            for each in batch.time.tolist():
                os.write(1, f"event {each}\n".encode())


def recording(
    sink: Dataset,
    rates: tuple[float, float],
    produced: NDArray[np.int64],
    alerts: TestSink | None = None,
) -> Flow:
    """Declare a flow that records two streams and counts their rows; an alert for each touch row."""
    count = produced.__setitem__
    flow = Flow(SESSION)
    touched = flow.source(Numbered(Touch, touch, rates[0], partial(count, 0)), "touch")
    moved = flow.source(Numbered(Motion, motion, rates[1], partial(count, 1), (EVERY,)), "motion")
    touched.to(sink)
    moved.to(sink)
    if alerts:
        (touched | Zero(500) | Alternating()).to(alerts)
    return flow


async def record(folder: str, counts_file: str, rate: str) -> None:
    """Record until killed."""
    counts: NDArray[np.int64] = np.memmap(counts_file, np.int64, "r+")
    sink = Counted(Path(folder), counts[ACCEPTED])
    flow = recording(sink, (float(rate), MOTION_FACTOR * float(rate)), counts[PRODUCED])
    await LiveRunner(flow, SESSION).execute()


def set_full(folder: Path, how: str) -> None:
    """Fill the disk to the last byte."""
    if how == "limit":
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))
        return
    with suppress(OSError), (folder / FILLER).open("wb", buffering=0) as file:
        for block in (4096, 1):
            with suppress(OSError):
                while file.write(bytes(block)):
                    pass


def set_free(folder: Path, how: str) -> None:
    """Undo `set_full`."""
    if how == "limit":
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    else:
        (folder / FILLER).unlink()


async def fill(place: str, how: str, full: str, room: str) -> None:
    """Record, and print the rows produced and their fate."""
    folder, produced, alerts = Path(place), np.zeros(2, np.int64), TestSink()
    recorder = DatasetOfFew(folder / "data")
    recorder.part_span = 300 * ms
    runner = LiveRunner(recording(recorder, (RATE, RATE), produced, alerts), SESSION)
    running = asyncio.create_task(runner.execute())
    await asyncio.sleep(0.7)
    set_full(folder, how)
    before = len(alerts.written)
    await asyncio.sleep(float(full))
    during, while_full = len(alerts.written) - before, health(runner.run)
    set_free(folder, how)
    await asyncio.sleep(float(room))
    after = health(runner.run)
    runner.stop()
    run = await running
    report = {
        "produced": produced.tolist(),
        "alerts": len(alerts.rows(Slips, 0)),
        "during": during,
        "health": while_full["sinks"],
        "after": after["sinks"],
        "sink": {name: asdict(sink) for name, sink in run.sinks.items()},
    }
    os.write(1, json.dumps(report).encode() + b"\n")


async def publish(url: str, outbox: str) -> None:
    """Publish events until SIGTERM."""
    flow = Flow("chaos")
    zeroed = flow.source(Numbered(Touch, touch, EVENTS), "touch") | Zero(515)
    (zeroed | Alternating()).to(ReportingMqtt(url, "chaos", "rig", outbox=outbox, connect_required=False))
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
    asyncio.run({"record": record, "fill": fill, "publish": publish, "follow": follow}[name](*arguments))  # type: ignore[operator]

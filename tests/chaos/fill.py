"""A recorder whose disk is full for a while, in a process of its own.

    python -m tests.chaos.fill FOLDER HOW FULL ROOM

FOLDER lies on a small file system of its own (HOW is ``tmpfs``), or no file may grow any more while the disk
is "full" (HOW is ``limit``). It is full for FULL seconds, then has room for ROOM seconds; with ROOM 0 it is
still full when the run ends. Prints a JSON object.
"""

import asyncio
import json
import os
import resource
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from connectors.health_report import HealthReports
from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.run.live_runner import LiveRunner
from operators import EVERY, Align, Label, Motion, Slips, Touch, Zero, ms
from storage import Dataset
from tests.chaos.devices import Turning
from tests.chaos.numbered import Numbered, motion, touch

RATE = 400.0  # rows/s of touch
QUEUE = 200  # batches that wait for the recorder
BEFORE = 0.7  # s
SESSION = "full"
FILLER = "filler"
NAME = "datasetoffew"  # of the recorder, as health calls it


class DatasetOfFew(Dataset):
    """Few batches may wait for it, so that there is something to drop."""

    capacity = QUEUE


def fill(folder: Path, how: str) -> None:
    """Leave no room for another byte."""
    if how == "limit":
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))
        return
    with suppress(OSError), (folder / FILLER).open("wb", buffering=0) as file:
        for block in (4096, 1):
            with suppress(OSError):
                while file.write(bytes(block)):
                    pass


def make_room(folder: Path, how: str) -> None:
    """As there was before."""
    if how == "limit":
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    else:
        (folder / FILLER).unlink()


async def main(folder: Path, how: str, full: float, room: float) -> object:
    """Record; say what was given and what became of it."""
    given = {"touch": 0, "motion": 0}

    def count(name: str) -> Callable[[int], None]:
        return lambda rows: given.update({name: rows})

    flow, alerts = Flow("full"), TestSink()
    recorder = DatasetOfFew(folder / "data", part_span=300 * ms)
    touched = flow.source(Numbered(Touch, touch, RATE, count("touch")), "touch")
    moved = flow.source(Numbered(Motion, motion, RATE, count("motion"), (EVERY,)), "motion")
    zeroed = touched | Zero(500)
    touched.to(recorder)
    moved.to(recorder)
    (zeroed & moved | Align(within=20 * ms) | Label(speed=0.003)).to(recorder)
    (zeroed | Turning()).to(alerts)
    runner = LiveRunner(flow, SESSION)
    reports = HealthReports(runner.run)
    running = asyncio.create_task(runner.execute())
    await asyncio.sleep(BEFORE)
    fill(folder, how)
    before = len(alerts.written)
    await asyncio.sleep(full)
    during, health = len(alerts.written) - before, reports.next()
    if room:
        make_room(folder, how)
        await asyncio.sleep(room)
    after = reports.next()
    runner.stop()
    run = await running
    if not room:
        make_room(folder, how)
    return {
        "given": given,
        "alerts": len(alerts.rows(Slips, 0)),
        "during": during,
        "health": health["sinks"],
        "after": after["sinks"],
        "sink": {name: asdict(sink) for name, sink in run.sinks.items()},
    }


if __name__ == "__main__":
    place, method, *seconds = sys.argv[1:]
    told = asyncio.run(main(Path(place), method, *map(float, seconds)))
    os.write(1, json.dumps(told).encode())

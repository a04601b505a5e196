"""Recorder whose disk is full for some time, as a process.

    python -m tests.chaos.fill FOLDER HOW FULL ROOM

FOLDER is on a small file system (HOW is ``tmpfs``), or files may not grow while the disk is "full" (HOW is
``limit``). The disk is full for FULL seconds, then free for ROOM seconds. Prints a JSON object.
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

from connectors.mqtt.mqtt_sink import HealthReports
from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.run.live_runner import LiveRunner
from operators import EVERY, Align, Label, Motion, Slips, Touch, Zero, ms
from storage import Dataset
from tests.chaos.numbered import Numbered, motion, touch
from tests.chaos.publish import Alternating

RATE = 400.0  # rows/s of touch
QUEUE = 200  # batches in the queue of the recorder
BEFORE = 0.7  # s
SESSION = "full"
FILLER = "filler"
NAME = "datasetoffew"  # of the recorder in health


class DatasetOfFew(Dataset):
    """Dataset with a short queue, so that rows are dropped."""

    capacity = QUEUE


def fill(folder: Path, how: str) -> None:
    """Fill the disk to the last byte."""
    if how == "limit":
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))
        return
    with suppress(OSError), (folder / FILLER).open("wb", buffering=0) as file:
        for block in (4096, 1):
            with suppress(OSError):
                while file.write(bytes(block)):
                    pass


def free(folder: Path, how: str) -> None:
    """Undo `fill`."""
    if how == "limit":
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    else:
        (folder / FILLER).unlink()


async def main(folder: Path, how: str, full: float, room: float) -> object:
    """Record, and return the rows produced and their fate."""
    produced = {"touch": 0, "motion": 0}

    def count(name: str) -> Callable[[int], None]:
        return lambda rows: produced.update({name: rows})

    flow, alerts = Flow("full"), TestSink()
    recorder = DatasetOfFew(folder / "data", part_span=300 * ms)
    touch_stream = flow.source(Numbered(Touch, touch, RATE, count("touch")), "touch")
    motion_stream = flow.source(Numbered(Motion, motion, RATE, count("motion"), (EVERY,)), "motion")
    zeroed = touch_stream | Zero(500)
    touch_stream.to(recorder)
    motion_stream.to(recorder)
    (zeroed & motion_stream | Align(within=20 * ms) | Label(speed=0.003)).to(recorder)
    (zeroed | Alternating()).to(alerts)
    runner = LiveRunner(flow, SESSION)
    reports = HealthReports(runner.run)
    running = asyncio.create_task(runner.execute())
    await asyncio.sleep(BEFORE)
    fill(folder, how)
    before = len(alerts.written)
    await asyncio.sleep(full)
    during, health = len(alerts.written) - before, reports.next()
    free(folder, how)
    await asyncio.sleep(room)
    after = reports.next()
    runner.stop()
    run = await running
    return {
        "produced": produced,
        "alerts": len(alerts.rows(Slips, 0)),
        "during": during,
        "health": health["sinks"],
        "after": after["sinks"],
        "sink": {name: asdict(sink) for name, sink in run.sinks.items()},
    }


if __name__ == "__main__":
    place, method, *seconds = sys.argv[1:]
    report = asyncio.run(main(Path(place), method, *map(float, seconds)))
    os.write(1, json.dumps(report).encode() + b"\n")

"""CPU cost of a sample against fingertips, sinks, hours of a recording, and workers.

Run by `make bench`. The flow is touch | Zero | Score(tcn), and Debounce in replays. Fingertips and sinks:
live runs of samples in memory, one row per batch, from the first to the last, medians of the turns; each
sink takes every score. Hours: replays of one recording in a process of its own, whose peak memory is shown,
after another replay. Workers: `slipflow run live --replay` over eight recordings of one hour, with the start
of the processes. The recordings are those of the paper plan end to end, in a temporary folder, 4 MB per hour.
"""

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from typing import Final
from unittest.mock import patch

import numpy as np

from flows.graph import Flow
from flows.graph.testing import TestSink
from flows.lab.simulation import simulate
from flows.report.table import Table
from flows.run import executor
from flows.run.clocks import EventClock
from flows.run.live_runner import LiveRunner
from flows.run.replays import FlowSource, Replays, recordings
from operators import Batch, Clock, Run, Score, Source, Touch, Zero, s
from operators.batch import concat
from storage import Session, load_detector
from storage.description import describe_dataset, describe_session
from storage.layout import TOUCH, file_name, session_folder
from storage.parts import Part, write_manifest, write_part
from storage.schema import to_arrow
from tests.benchmarks.bench_replay import BLOCK, RATE, Watch, replay
from tests.benchmarks.machine import print_head, take_turns

BASELINE: Final = 700  # counts
SAMPLES: Final = 20_000  # at least, of a live run
HOURS: Final = (1, 30)
TURNS: Final = 3


@dataclass(frozen=True)
class Point:
    """A row of the table."""

    grows: str
    value: int
    cost: float  # CPU us per sample
    remark: str = ""


@dataclass
class Memory(Source[Touch]):
    """Rows of some fingertips in turn, without waiting."""

    count: int  # fingertips
    touch: Touch
    cpu: float = field(default=0.0, init=False)  # s, from the first batch to the last

    @property
    def kind(self) -> type[Touch]:
        """Touch."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """All."""
        return tuple(range(self.count))

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """Yield the rows; their stamps begin now."""
        time_ = clock.now() + np.arange(len(self.touch)) * (s // RATE)
        touch, batches = replace(self.touch, time=time_), list[Touch]()
        for row in range(len(touch)):
            batches += [replace(touch[row : row + 1], finger=finger) for finger in self.fingers]
        began = time.process_time()
        for batch in batches:
            yield batch
        self.cpu = time.process_time() - began


class Forgetful(TestSink):
    """Sink that keeps nothing, so that the memory is that of the replay."""

    def take(self, batch: Batch) -> bool:
        """Accept the batch."""
        return True

    async def write(self, batch: Batch) -> None:
        """Accept the batch."""


async def carry_out(flow: Flow) -> Run:
    """Run a flow live."""
    return await LiveRunner(flow, "scaling").execute()


def live(touch: Touch, fingers: int = 1, sinks: int = 1) -> float:
    """Run live and return the CPU us per sample."""
    size = max(20, SAMPLES // fingers)
    source, flow = Memory(fingers, touch[np.arange(size) % len(touch)]), Flow("scaling")
    scores = flow.source(source) | Zero(BASELINE) | Score(load_detector("tcn"))
    for _ in range(sinks):
        scores.to(TestSink())
    asyncio.run(carry_out(flow))
    return source.cpu / size / fingers * 1e6


def lives(touch: Touch) -> list[Point]:
    """Measure fingertips and sinks, in turns."""
    runs = {("fingertips", number): partial(live, touch, number) for number in (1, 100, 1000)}
    runs |= {("sinks", number): partial(live, touch, 1, number) for number in (1, 8)}
    costs = take_turns(runs, TURNS)
    return [Point(of, number, statistics.median(found)) for (of, number), found in costs.items()]


def tiled(touch: Touch, out: Path, hours: int) -> Path:
    """Write a session of one fingertip of this length, in parts of a minute."""
    folder = session_folder(out, f"hours-{hours:03d}")
    (folder / TOUCH.name).mkdir(parents=True)
    describe_dataset(out)
    start = int(touch.time[0])
    describe_session(folder, Run(folder.name, "tiled", EventClock(start), start, live=False), "")
    parts, tiles = list[Part](), len(touch) // BLOCK
    for number in range(hours * 60):
        first = number % tiles * BLOCK
        time_ = start + (number * BLOCK + np.arange(BLOCK)) * (s // RATE)
        rows = to_arrow(TOUCH, [replace(touch[first : first + BLOCK], time=time_)])
        parts.append(write_part(folder, file_name(TOUCH.pattern, number), rows))
    write_manifest(folder, parts)
    return folder


def one(first: Path, path: Path) -> None:
    """Replay a recording in this process after another, and print what it took."""
    replay([first], Forgetful, Watch())
    watch = Watch()
    samples = replay([path], Forgetful, watch)
    peak = getrusage(RUSAGE_SELF).ru_maxrss / 1024  # MiB
    print(json.dumps({"cost": sum(watch.seconds.values()) / samples * 1e6, "peak": peak}))


def lengths(touch: Touch, first: Path, out: Path) -> list[Point]:
    """Measure recordings of several lengths."""
    with patch("os.fsync"):  # what is made only to be read need not be durable
        folders = [tiled(touch, out, hours) for hours in HOURS]
    points = list[Point]()
    for hours, folder in zip(HOURS, folders, strict=True):
        command = [sys.executable, __file__, "--one", str(first), str(folder)]
        done = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        points.append(Point("hours", hours, done["cost"], f"peak memory {done['peak']:.0f} MiB"))
    return points


def workers(hour: Path) -> list[Point]:
    """Measure processes; the printed slips must be the same."""
    points, walls, printed = list[Point](), list[float](), set[tuple[str, ...]]()
    for jobs in (1, 2, 4):
        began, before = time.perf_counter(), _cpu()
        with executor.workers(jobs) as processes:
            found = list(Replays(FlowSource("live"), [hour] * 8).run(processes))
        walls.append(time.perf_counter() - began)
        cost = (_cpu() - before) / (8 * 3600 * RATE) * 1e6
        printed.add(tuple(each.printed for each in found))
        points.append(Point("workers", jobs, cost, f"{walls[0] / walls[-1]:.2f} times as fast as one"))
    if len(printed) != 1:
        raise SystemExit("other slips with other processes")
    return points


def _cpu() -> float:
    """Return the CPU time of this process and of those it started that have ended, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def table(points: Sequence[Point]) -> Table:
    """Return the table; each cost is compared with the first of its kind."""
    first: dict[str, float] = {}
    rows = [(p.grows, p.value, p.cost, p.cost / first.setdefault(p.grows, p.cost), p.remark) for p in points]
    head = ["what grows", "number", "CPU us per sample", "relative", "remark"]
    return Table(head, rows, decimals={"CPU us per sample": 2, "relative": 2})


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", type=Path, nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        one(*options.one)
        return
    print_head(f"medians of {TURNS} turns")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        paths = recordings([simulate(out / "paper", "paper", 0)])
        touch = concat(Touch, [batch for path in paths for batch in Session.open(path).read(Touch, 0, BLOCK)])
        points = [*lives(touch), *lengths(touch, paths[0], out / "long")]
        points += workers(session_folder(out / "long", f"hours-{min(HOURS):03d}"))
    print(table(points).markdown())


if __name__ == "__main__":
    main()

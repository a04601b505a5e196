"""What a replay costs: Parquet to slips with the shipped detector, by stage, by length, by processes.

Run by `make bench`. The flow is touch | Zero | Score(tcn) | Debounce. One core: CPU time of one process,
after the imports and the detector's compilation, for which another replay comes first. The long recordings
are those of the paper plan end to end, over and over at later times, in parts of a minute as a recorder
makes them; they lie in a temporary folder, 4 MB for an hour. Each is replayed in a process of its own,
whose peak memory is told.
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
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from typing import Any, cast
from unittest.mock import patch

import numpy as np

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.lab.simulation import simulate
from flows.report.figures import MAIN, SECOND, Figure, grid, save, styled
from flows.run.clocks import EventClock
from flows.run.parallel_replay import Replays, recordings
from flows.run.replay_runner import ReplayRunner
from operators import Batch, Debounce, Operator, Run, Score, Sink, Slips, Touch, Zero
from operators.batch import concat, s
from operators.ports import Description
from storage import Dataset, Session, load_debounce, load_detector
from storage.description import describe_dataset, describe_session
from storage.layout import TOUCH, session_folder
from storage.manifest import Part, write_manifest
from storage.parts import manifest_entry, write_part
from storage.schema import to_arrow
from tests.benchmarks.machine import commit, machine

RATE = 100  # Hz
MINUTE = 60 * RATE  # rows
BLOCK = MINUTE  # rows of a part
STAGES = ("open", "check and plan", "read", "Zero", "Score", "Debounce", "the rest")
FLOW = """
from connectors import Console
from flows.graph import Flow
from flows.graph.testing import TestSource
from operators import Score, Touch, Zero
from storage import load_debounce, load_detector

def slips() -> Flow:
    flow = Flow("slips")
    zeroed = flow.source(TestSource(Touch)) | Zero()
    (zeroed | Score(load_detector("tcn")) | load_debounce("tcn")).to(Console())
    return flow
"""


def flow(sink: Sink[Slips]) -> Flow:
    """What is replayed."""
    job = Flow("slips")
    slips = job.source(TestSource(Touch)) | Zero() | Score(load_detector("tcn"))
    (slips | (load_debounce("tcn") or Debounce())).to(sink)
    return job


@dataclass
class Watch:
    """CPU and wall time by stage, of one process."""

    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))  # CPU
    waited: float = 0.0  # s, of the whole, that were not CPU

    @contextmanager
    def stage(self, name: str) -> Generator[None]:
        """What is done within belongs to a stage."""
        began = time.process_time()
        try:
            yield
        finally:
            self.seconds[name] += time.process_time() - began


@dataclass
class Watched:
    """A session whose reading is timed."""

    session: Session
    watch: Watch

    @property
    def name(self) -> str:
        """Its name."""
        return self.session.name

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """As the session."""
        return self.session.fingers(kind)

    def read(self, kind: Any, finger: int, rows: int = 1000) -> Iterator[Any]:  # noqa: ANN401 - as the protocol
        """As the session, timed."""
        batches = self.session.read(kind, finger, rows)
        while True:
            with self.watch.stage("read"):
                batch = next(batches, None)
            if batch is None:
                return
            yield batch

    def describe(self) -> Description:
        """As the session."""
        return self.session.describe()


@contextmanager
def timed(watch: Watch) -> Generator[None]:
    """Operators and sinks are timed meanwhile, by the names of their classes."""
    kinds: list[Any] = [Zero, Score, Debounce]
    before = [kind.process for kind in kinds]

    def wrapped(kind: Any, process: Callable[..., Any]) -> Callable[..., Any]:  # noqa: ANN401
        def run(self: Operator[Any, Any], batch: Batch) -> Batch:
            with watch.stage(kind.__name__):
                return cast("Batch", process(self, batch))

        run.__annotations__ = process.__annotations__
        return run

    for kind, process in zip(kinds, before, strict=True):
        kind.process = wrapped(kind, process)
    try:
        yield
    finally:
        for kind, process in zip(kinds, before, strict=True):
            kind.process = process


def replay(paths: Sequence[Path], sink: Callable[[], Sink[Slips]], rows: int, watch: Watch) -> int:
    """Replay sessions one after the other; gives the rows."""
    total, began, wall = 0, time.process_time(), time.perf_counter()
    for number, path in enumerate(paths):
        with watch.stage("open"):
            session = Session.open(path)
        with watch.stage("check and plan"):
            runner = ReplayRunner(flow(sink()), Watched(session, watch), f"again-{number}", rows=rows)
        run = asyncio.run(runner.execute())
        total += run.sources["touch"].rows
    cpu = time.process_time() - began
    watch.waited = time.perf_counter() - wall - cpu
    watch.seconds["the rest"] = cpu - sum(watch.seconds.values())
    return total


def paper(paths: Sequence[Path], turns: int, rows: int) -> None:
    """Print the stages of the paper plan's replay."""
    watches, plain, recorded = list[Watch](), list[float](), list[Watch]()
    samples = 0
    for turn in range(turns + 1):  # the first one warms up
        bare, staged, written = Watch(), Watch(), Watch()
        samples = replay(paths, TestSink, rows, bare)
        with timed(staged):
            replay(paths, TestSink, rows, staged)
        with tempfile.TemporaryDirectory() as out:
            replay(paths, partial(Dataset, out), rows, written)
        if turn:
            watches.append(staged)
            plain.append(sum(bare.seconds.values()))
            recorded.append(written)
    print(f"the paper plan: {len(paths)} sessions, {samples / RATE / 60:.0f} minutes, {samples:,} samples")
    print(f"{'CPU s, batches of ' + str(rows):32}{'s':>8}{'us/sample':>12}")
    for name in STAGES:
        if seconds := statistics.median(watch.seconds[name] for watch in watches):
            print(f"  {name:30}{seconds:8.3f}{seconds / samples * 1e6:12.2f}")
    seconds, kept = (
        statistics.median(plain),
        statistics.median(sum(each.seconds.values()) for each in recorded),
    )
    print(f"{'Parquet to slips':32}{seconds:8.3f}{seconds / samples * 1e6:12.2f}")
    print(f"{'Parquet to a dataset of slips':32}{kept:8.3f}{kept / samples * 1e6:12.2f}")
    print(f"{'  and waiting for the disk':32}{statistics.median(each.waited for each in recorded):8.1f}")


def tiled(paths: Sequence[Path], out: Path, hours: int) -> Path:
    """A recording of one fingertip that long, as a session."""
    touch = concat(Touch, [batch for path in paths for batch in Session.open(path).read(Touch, 0, BLOCK)])
    folder = session_folder(out, f"hours-{hours:03d}")
    (folder / TOUCH.name).mkdir(parents=True)
    describe_dataset(out)
    start = int(touch.time[0])
    describe_session(folder, Run(folder.name, "tiled", EventClock(start), start, live=False))
    parts, tiles = list[Part](), len(touch) // BLOCK
    for number in range(hours * 60):
        first = number % tiles * BLOCK
        time_ = start + (number * BLOCK + np.arange(BLOCK)) * (s // RATE)
        rows = to_arrow(TOUCH, [replace(touch[first : first + BLOCK], time=time_)])
        parts.append(manifest_entry(TOUCH.file(number), rows, write_part(folder / TOUCH.file(number), rows)))
    write_manifest(folder, parts)
    return folder


def shorter(folder: Path, hours: int) -> Path:
    """The first hours of a session, as another, of the same files."""
    other = folder.with_name(f"hours-{hours:03d}")
    (other / TOUCH.name).mkdir(parents=True)
    session = Session.open(folder)
    parts = [session.listed[TOUCH.file(number)] for number in range(hours * 60)]
    for part in parts:
        os.link(folder / part.path, other / part.path)
    describe_session(other, Run(other.name, "tiled", EventClock(parts[0].first), parts[0].first, live=False))
    write_manifest(other, parts)
    return other


def one(first: Path, path: Path, rows: int) -> None:
    """Replay one recording in this process, and print what it took; another replay comes first."""
    replay([first], TestSink, rows, Watch())
    watch = Watch()
    samples = replay([path], TestSink, rows, watch)
    peak = getrusage(RUSAGE_SELF).ru_maxrss / 1024  # MiB
    print(json.dumps({"samples": samples, "cpu": sum(watch.seconds.values()), "peak": peak}))


def scale(
    paths: Sequence[Path], hours: Sequence[int], rows: int, out: Path
) -> list[tuple[int, float, float]]:
    """Print cost and peak memory by length; gives hours, us per sample, MiB."""
    with patch("os.fsync"):  # what is made only to be read need not be durable
        longest = tiled(paths, out, max(hours))
        folders = {each: longest if each == max(hours) else shorter(longest, each) for each in hours}
    print(f"{'hours':>6}{'samples':>13}{'CPU s':>9}{'us/sample':>11}{'x real time':>13}{'peak MiB':>10}")
    found = list[tuple[int, float, float]]()
    for each, folder in folders.items():
        command = [sys.executable, __file__, "--one", str(paths[0]), str(folder), "--rows", str(rows)]
        done = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        samples, cpu, peak = done["samples"], done["cpu"], done["peak"]
        found.append((each, cpu / samples * 1e6, peak))
        print(
            f"{each:6}{samples:13,}{cpu:9.2f}{found[-1][1]:11.2f}{samples / RATE / cpu:13,.0f}{peak:10.0f}",
            flush=True,
        )
    return found


def processes(title: str, paths: Sequence[Path], turns: int, out: Path) -> None:
    """Print what two processes gain in time, and what they cost."""
    (out / "slips.py").write_text(FLOW)
    wall: dict[int, list[float]] = {1: [], 2: []}
    cpu: dict[int, list[float]] = {1: [], 2: []}
    printed = set[tuple[str, ...]]()
    for _ in range(turns):
        for jobs, seconds in wall.items():
            began, before = time.perf_counter(), _cpu()
            found = list(Replays(str(out / "slips.py"), {}, paths, "again").run(jobs))
            seconds.append(time.perf_counter() - began)
            cpu[jobs].append(_cpu() - before)
            printed.add(tuple(each.printed for each in found))
    if len(printed) != 1:
        raise SystemExit(f"{title}: other slips with other processes")
    one, two, *costs = (statistics.median(values) for values in (*wall.values(), *cpu.values()))
    gain = statistics.median(a / b for a, b in zip(*wall.values(), strict=True))
    print(f"{title:32}{one:8.2f}{two:8.2f}{gain:8.2f}{costs[0]:10.2f}{costs[1]:8.2f}")


def _cpu() -> float:
    """CPU time of this process and of those it started that have ended, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@styled
def chart(found: Sequence[tuple[int, float, float]]) -> Figure:
    """Cost and memory by length."""
    hours, cost, peak = zip(*found, strict=True)
    figure, (left, right) = grid(1, 2, (8, 3))
    for axes, values, colour, label in (
        (left, cost, MAIN, "CPU us per sample"),
        (right, peak, SECOND, "peak memory, MiB"),
    ):
        axes.plot(hours, values, "o-", color=colour)
        axes.set(
            xscale="log",
            xticks=hours,
            xlabel="hours of one fingertip at 100 Hz",
            ylabel=label,
            ylim=(0, 1.3 * max(values)),
        )
        axes.set_xticks(hours, [str(each) for each in hours])
        axes.minorticks_off()
        axes.grid(axis="y")
    figure.suptitle(
        f"From {hours[0]} to {hours[-1]} hours of data a sample costs {min(cost):.1f} to {max(cost):.1f} us, "
        f"and memory stays within {min(peak):.0f} to {max(peak):.0f} MiB",
        x=0.01,
        ha="left",
        fontsize=9,
        fontweight="bold",
    )
    return figure


def main() -> None:
    """Measure, print the tables and draw the chart."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", type=Path, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--hours", type=int, nargs="+", default=[1, 3, 10, 30, 100])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, default=Path("docs/figures/replay-scale.svg"))
    options = parser.parse_args()
    if options.one:
        first, path = options.one
        one(first, path, options.rows)
        return
    print(f"seed {options.seed}, medians of {options.turns} turns, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(f"load {os.getloadavg()[0]:.1f} at the beginning", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        paths = recordings([simulate(out / "paper", "paper", options.seed).out])
        paper(paths, options.turns, options.rows)
        found = scale(paths, options.hours, options.rows, out / "long")
        save(chart(found), options.figure)
        hour = session_folder(out / "long", f"hours-{min(options.hours):03d}")
        print(f"{'by processes, their start in it':32}{'wall 1':>8}{'2':>8}{'gain':>8}{'CPU 1':>10}{'2':>8}")
        processes(f"the paper plan, {len(paths)} sessions", paths, options.turns, out)
        processes(f"8 sessions of {min(options.hours)} h", [hour] * 8, options.turns, out)


if __name__ == "__main__":
    main()

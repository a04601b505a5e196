"""What a replay of short sessions costs: Parquet to slips with the shipped detector, by stage.

Run by `make bench`. The flow is touch | Zero | Score(tcn) | Debounce. CPU time of one process, after the
imports and the detector's compilation, for which another replay comes first.
"""

import asyncio
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSink, TestSource
from flows.lab.simulation import simulate
from flows.run.replay_runner import ReplayRunner
from flows.run.replays import recordings
from operators import Score, Sink, Slips, Touch, Zero
from storage import Dataset, Session, load_debounce, load_detector
from tests.benchmarks.machine import print_head

RATE = 100  # Hz
TURNS, ROWS = 5, 1000  # rows of a batch
STAGES = ("open", "check and plan", "read", "operators", "the rest")


def flow(sink: Sink[Slips]) -> Flow:
    """What is replayed."""
    job = Flow("slips")
    slips = job.source(TestSource(Touch)) | Zero() | Score(load_detector("tcn"))
    (slips | load_debounce("tcn")).to(sink)
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


@contextmanager
def timed(watch: Watch) -> Generator[None]:
    """The operators and the reading of sessions are timed meanwhile."""
    session, compiled = cast("Any", Session), cast("Any", CompiledFlow)
    real, push = session.read, compiled.push

    def read(*asked: Any) -> Iterator[Any]:
        batches = real(*asked)
        while True:
            with watch.stage("read"):
                batch = next(batches, None)
            if batch is None:
                return
            yield batch

    def pushed(*given: Any) -> Any:
        with watch.stage("operators"):
            return push(*given)

    session.read, compiled.push = read, pushed
    try:
        yield
    finally:
        session.read, compiled.push = real, push


def replay(paths: Sequence[Path], sink: Callable[[], Sink[Slips]], watch: Watch) -> int:
    """Replay sessions one after the other, with one flow and event loop as `slipflow run`; gives the rows."""
    total, began, wall = 0, time.process_time(), time.perf_counter()
    with watch.stage("check and plan"):
        job = flow(sink())
    with asyncio.Runner() as loop:
        for number, path in enumerate(paths):
            with watch.stage("open"):
                session = Session.open(path)
            with watch.stage("check and plan"):
                runner = ReplayRunner(job, session, f"again-{number}", rows=ROWS)
            total += loop.run(runner.execute()).sources["touch"].rows
    cpu = time.process_time() - began
    watch.waited = time.perf_counter() - wall - cpu
    watch.seconds["the rest"] = cpu - sum(watch.seconds.values())
    return total


def paper(paths: Sequence[Path]) -> None:
    """Print the stages of the paper plan's replay."""
    watches, plain, recorded = list[Watch](), list[float](), list[Watch]()
    samples = 0
    for turn in range(TURNS + 1):  # the first one warms up
        bare, staged, written = Watch(), Watch(), Watch()
        samples = replay(paths, TestSink, bare)
        with timed(staged):
            replay(paths, TestSink, staged)
        with tempfile.TemporaryDirectory() as out:
            replay(paths, partial(Dataset, out), written)
        if turn:
            watches.append(staged)
            plain.append(sum(bare.seconds.values()))
            recorded.append(written)
    print(f"the paper plan: {len(paths)} sessions, {samples / RATE / 60:.0f} minutes, {samples:,} samples")
    print(f"{'CPU s, batches of ' + str(ROWS):32}{'s':>8}{'us/sample':>12}")
    for name in STAGES:
        if seconds := statistics.median(watch.seconds[name] for watch in watches):
            print(f"  {name:30}{seconds:8.3f}{seconds / samples * 1e6:12.2f}")
    seconds = statistics.median(plain)
    kept = statistics.median(sum(each.seconds.values()) for each in recorded)
    print(f"{'Parquet to slips':32}{seconds:8.3f}{seconds / samples * 1e6:12.2f}")
    print(f"{'Parquet to a dataset of slips':32}{kept:8.3f}{kept / samples * 1e6:12.2f}")
    print(f"{'  and waiting for the disk':32}{statistics.median(each.waited for each in recorded):8.1f}")


def main() -> None:
    """Measure and print the stages."""
    print_head(f"medians of {TURNS} turns")
    with tempfile.TemporaryDirectory() as folder:
        paper(recordings([simulate(Path(folder) / "paper", "paper", 0)]))


if __name__ == "__main__":
    main()

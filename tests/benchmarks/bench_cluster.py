"""Samples per second of a Flink cluster on this machine, with one worker and with two.

Run by hand, after `make cluster`. The job relabels recordings of many fingertips: in one process, one after
the other, then on the cluster. Starting a job takes many seconds; so it runs with several sessions and with
one, and the difference counts. The rows of all must be those of the one process, bit for bit.
"""

import argparse
import asyncio
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from flows.graph.loading import load
from flows.run.cluster.cluster_replay import PYTHON, Cluster
from flows.run.replay_runner import ReplayRunner
from operators.batch import Labelled, Motion, Slips, Touch, ms, s
from operators.ports import Run
from storage import Dataset, Session
from storage.layout import session_folder, session_names
from tests.benchmarks.machine import commit, machine

START = 1_700_000_000 * s


class Stopped:
    """A clock."""

    def now(self) -> int:
        return START

    async def sleep_until(self, time: int) -> None:
        raise AssertionError(time)


async def record(root: Path, session: str, fingers: int, seconds: int, seed: int) -> None:
    """Noise as a session: what the operators cost does not hang on what is felt."""
    random, dataset = np.random.default_rng(seed), Dataset(root, part_span=10 * s)
    await dataset.open(Run(session, "recorded", Stopped(), START, live=False))
    for begin in range(START, START + seconds * s, s):
        time = begin + np.arange(100) * 10 * ms
        for finger in range(fingers):
            counts = random.integers(200, 500, (100, 6)).astype(np.int16)
            await dataset.write(Touch(time, counts, counts, np.ones((100, 6), np.bool_), finger=finger))
        time = begin + 3 * ms + np.arange(125) * 8 * ms
        velocity = random.normal(0, 0.01, (125, 6))
        await dataset.write(Motion(time, time, velocity, np.full((125, 6), np.nan)))
    await dataset.close()


def same(one: Path, other: Path) -> bool:
    """Whether two datasets hold the same samples and slips, bit for bit."""
    for name in session_names(one):
        pair = [Session.open(session_folder(root, name)) for root in (one, other)]
        for kind in (Labelled, Slips):
            columns = kind.__dataclass_fields__
            for finger in pair[0].fingers(kind):
                for mine, theirs in zip(*(each.read(kind, finger) for each in pair), strict=True):
                    for column in columns:
                        a, b = getattr(mine, column), getattr(theirs, column)
                        if np.asarray(a).tobytes() != np.asarray(b).tobytes():
                            return False
    return session_names(one) == session_names(other)


@dataclass
class Job:
    """Seconds of replays of all sessions and of one."""

    name: str
    seconds: list[float] = field(default_factory=list[float])

    def measure(self, run: Callable[[], object]) -> None:
        """Run once."""
        began = perf_counter()
        run()
        self.seconds.append(perf_counter() - began)

    def print(self, samples: int, same: str = "") -> None:
        """Print a line; `samples` are those of all sessions but one."""
        whole, one = self.seconds
        print(f"{self.name:32}{whole:10.1f}{one:10.1f}{samples / (whole - one):12.0f}{same:>6}")


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="http://localhost:8081")
    parser.add_argument("--fingers", type=int, default=64)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--sessions", type=int, default=4)
    parser.add_argument("--slices", type=int, nargs="+", default=[16])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        for number in range(options.sessions):
            asyncio.run(record(root / "in", f"s{number}", options.fingers, options.seconds, number))
        samples = options.fingers * options.seconds * 100
        rest = samples * (options.sessions - 1)
        print(f"{options.sessions} sessions of {samples} samples, {options.fingers} fingertips, ", end="")
        print(f"commit {commit()}, load {os.getloadavg()[0]:.1f}")
        print(machine())
        print(f"{'':32}{'all, s':>10}{'one, s':>10}{'samples/s':>12}{'same':>6}")
        sessions = [session_folder(root / "in", name) for name in session_names(root / "in")]

        def replay(out: Path, given: list[Path]) -> None:
            for folder in given:
                flow = load("relabel").flow({"out": str(out)})
                asyncio.run(ReplayRunner(flow, Session.open(folder), folder.name).execute())

        replay(root / "first", sessions[:1])  # compiles
        one = Job("one process")
        for given in (sessions, sessions[:1]):
            out = root / f"single-{len(given)}"
            one.measure(partial(replay, out, given))
        one.print(rest)
        Cluster(options.url, PYTHON.absolute()).run(
            "first", load("relabel"), {"out": str(root / "warm")}, sessions[:1]
        )
        for slices in options.slices:
            for workers in (1, 2):
                job = Job(f"{workers} workers, {slices} slices per unit")
                for given in (sessions, sessions[:1]):
                    out = root / f"{workers}-{slices}-{len(given)}"
                    cluster = Cluster(options.url, PYTHON.absolute(), slices=slices, workers=workers)
                    run = partial(cluster.run, "bench", load("relabel"), {"out": str(out)}, given)
                    job.measure(run)
                outs = [root / f"{each}-{len(sessions)}" for each in ("single", f"{workers}-{slices}")]
                job.print(rest, str(same(*outs)))


if __name__ == "__main__":
    main()

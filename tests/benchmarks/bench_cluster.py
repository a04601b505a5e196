"""What a Flink cluster on this machine brings: samples per second with one worker and with two.

Run by hand, after `make cluster`. The job relabels recordings of many fingertips: in one process, one after
the other, then on the cluster. Starting a job takes many seconds; so it is done with one session and with
several, and the difference counts. The rows of all must be those of the one process, bit for bit.
"""

import argparse
import asyncio
import os
import tempfile
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


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="http://localhost:8081")
    parser.add_argument("--fingers", type=int, default=64)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--sessions", type=int, default=4)
    parser.add_argument("--slices", type=int, nargs="+", default=[8])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        for number in range(options.sessions):
            asyncio.run(record(root / "in", f"s{number}", options.fingers, options.seconds, number))
        samples = options.fingers * options.seconds * 100
        print(f"{options.sessions} sessions of {samples} samples, {options.fingers} fingertips, ", end="")
        print(f"commit {commit()}, load {os.getloadavg()[0]:.1f}")
        print(f"{machine()}")
        print(f"{'':32}{'all, s':>10}{'one, s':>10}{'samples/s':>12}{'same':>6}")
        sessions = [session_folder(root / "in", name) for name in session_names(root / "in")]
        began, first = perf_counter(), 0.0
        for count, folder in enumerate(sessions):
            flow = load("relabel").flow({"out": str(root / "single")})
            asyncio.run(ReplayRunner(flow, Session.open(folder), folder.name).execute())
            if count == 0:
                first = perf_counter() - began
        whole = perf_counter() - began
        rest = samples * (options.sessions - 1)
        print(f"{'one process':32}{whole:10.1f}{first:10.1f}{rest / (whole - first):12.0f}")
        for slices in options.slices:
            for workers in (1, 2):
                seconds = list[float]()
                name = f"{workers} workers, {slices} slices per unit"
                for given in (sessions, sessions[:1]):
                    out = root / f"{workers}-{slices}-{len(given)}"
                    began = perf_counter()
                    cluster = Cluster(options.url, PYTHON.absolute(), slices=slices, workers=workers)
                    cluster.run("bench", load("relabel"), {"out": str(out)}, given)
                    seconds.append(perf_counter() - began)
                equal = same(root / "single", root / f"{workers}-{slices}-{len(sessions)}")
                rate = rest / (seconds[0] - seconds[1])
                print(f"{name:32}{seconds[0]:10.1f}{seconds[1]:10.1f}{rate:12.0f}{equal!s:>6}")


if __name__ == "__main__":
    main()

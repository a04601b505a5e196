"""A Flink cluster on this machine, and recordings for it."""

import asyncio
import json
import os
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast
from urllib.request import Request, urlopen

import numpy as np
import pytest

from operators.batch import Motion, Touch, ms, s
from operators.ports import Run
from storage import Dataset

ROOT = Path(__file__).parents[2]
PORT = 8191
FLOW = '''
import time
from dataclasses import dataclass, field

from flows.graph import Flow
from flows.graph.testing import TestSource
from operators import Align, Debounce, Label, Motion, Operator, Score, Touch, Zero, Zeroed
from storage import Dataset, load_detector


@dataclass
class Slow(Operator[Zeroed, Zeroed]):
    """Delays each batch, and counts rows."""

    pause: float = field(default=0.0, repr=False)  # s, for each batch
    _seen: int = field(default=0, init=False, repr=False)

    def process(self, batch: Zeroed) -> Zeroed:
        time.sleep(self.pause)
        self._seen += len(batch)
        return batch


def slow(out: str = "out", pause: float = 0.0) -> Flow:
    flow, dataset = Flow("slow"), Dataset(out, part_span=100_000_000_000)
    touch = flow.source(TestSource(Touch))
    zeroed = touch | Zero() | Slow(pause)
    (zeroed & flow.source(TestSource(Motion)) | Align() | Label(delay=70_000_000)).to(dataset)
    (zeroed | Score(load_detector("tcn")) | Debounce(threshold=0.5)).to(dataset)
    return flow
'''

ONE_PROCESS = """
import asyncio, sys
from pathlib import Path
from flows.graph.loading import load
from flows.run.replay_runner import ReplayRunner
from storage import Session
from storage.layout import session_folder, session_names

target, source, out = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
for name in session_names(source):
    session = Session.open(session_folder(source, name))
    asyncio.run(ReplayRunner(load(target).flow({"out": out}), session, name).execute())
"""


@dataclass(frozen=True)
class Local:
    """The cluster."""

    url: str
    python: Path  # that has pyflink
    pids: Path  # of its task managers

    def ask(self, path: str, body: object = None) -> dict[str, Any]:
        """Return the response of its REST interface; with a body, to a POST."""
        data = None if body is None else json.dumps(body).encode()
        request = Request(self.url + path, data, {"Content-Type": "application/json"})  # noqa: S310 - ours
        with urlopen(request, timeout=10) as answer:  # noqa: S310 - the same
            return cast("dict[str, Any]", json.load(answer))

    def checkpoints(self, job: str) -> Counter[str]:
        """Return how many checkpoints of a job have each state."""
        return Counter(self.ask(f"/jobs/{job}/checkpoints").get("counts", {}))

    def processed_units(self, job: str) -> list[int]:
        """Return how many work units each worker has processed."""
        vertices = self.ask(f"/jobs/{job}")["vertices"]
        [work] = [each for each in vertices if each["name"].startswith("process units")]
        workers = self.ask(f"/jobs/{job}/vertices/{work['id']}")["subtasks"]
        assert len({each["endpoint"] for each in workers}) == len(workers)
        return [each["metrics"]["write-records"] for each in workers]

    def job_managers(self) -> list[int]:
        """Return the id of the running job manager."""
        [file] = self.pids.parent.glob("*standalonesession.pid")
        return _running(file)

    def task_managers(self) -> list[int]:
        """Return the ids of the running task managers."""
        return _running(self.pids)

    def workers(self) -> list[int]:
        """Return the ids of the Python workers, including those whose task manager was killed."""
        found = [
            path
            for path in Path("/proc").glob("[0-9]*")
            if b"pyflink.fn_execution" in _read(path / "cmdline")
        ]
        mark = f"FLINK_PID_DIR={self.pids.parent}".encode()
        return [int(path.name) for path in found if mark in _read(path / "environ").split(b"\0")]


def _running(file: Path) -> list[int]:
    return [int(each) for each in file.read_text().split() if Path(f"/proc/{each}").exists()]


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # it ended meanwhile
        return b""


def start() -> None:
    subprocess.run(["deploy/cluster"], cwd=ROOT, env={**os.environ, "PORT": str(PORT)}, check=True)


def stop() -> None:
    subprocess.run(["deploy/cluster", "stop"], cwd=ROOT, env={**os.environ, "PORT": str(PORT)}, check=True)


@pytest.fixture(scope="session")
def local() -> Iterator[Local]:
    """A job manager and two task managers."""
    start()
    folder = ROOT / ".cluster"
    [pids] = (folder / f"at-{PORT}" / "pid").glob("*taskexecutor.pid")
    yield Local(f"http://localhost:{PORT}", folder / "bin" / "python", pids)
    stop()


class Stopped:
    """A clock."""

    def now(self) -> int:
        return 1_700_000_000 * s

    async def sleep_until(self, time: int) -> None:
        raise AssertionError(time)


class Recorder:
    """Records a session with many fingertips step by step."""

    def __init__(self, root: Path, session: str, fingers: int, seed: int = 0) -> None:
        self._random = np.random.default_rng(seed)
        self._fingers, self._time = fingers, 1_700_000_000 * s
        self._dataset = Dataset(root, part_span=20 * s, host="test")
        self._run = Run(session, "recorded", Stopped(), self._time, live=False)
        self._loop = asyncio.new_event_loop()
        self._loop.run_until_complete(self._dataset.open(self._run))

    def record(self, seconds: int) -> None:
        for _ in range(seconds):
            time = self._time + np.arange(100) * 10 * ms
            for finger in range(self._fingers):
                counts = self._random.integers(200, 500, (100, 6)).astype(np.int16)
                touch = Touch(time + finger, counts, counts, np.ones((100, 6), np.bool_), finger=finger)
                self._loop.run_until_complete(self._dataset.write(touch))
            time = self._time + 3 * ms + np.arange(125) * 8 * ms
            velocity = self._random.normal(0, 0.01, (125, 6))
            motion = Motion(time, time, velocity, np.full((125, 6), np.nan))
            self._loop.run_until_complete(self._dataset.write(motion))
            self._time += s

    def close(self) -> None:
        self._loop.run_until_complete(self._dataset.close())
        self._loop.close()


@dataclass(frozen=True)
class World:
    """A cluster, a flow, and a folder for datasets."""

    local: Local
    root: Path

    @property
    def flow(self) -> Path:
        """The flow's file."""
        return self.root / "slow_flow.py"

    @property
    def source(self) -> Path:
        """The dataset to run over."""
        return self.root / "source"

    @property
    def out(self) -> Path:
        """The dataset that the cluster writes."""
        return self.root / "many"

    def record(self, sessions: int, fingers: int, seconds: int) -> None:
        """Fill the source."""
        for number in range(sessions):
            recorder = Recorder(self.source, f"session-{number}", fingers, seed=number)
            recorder.record(seconds)
            recorder.close()

    def expected(self) -> dict[str, bytes]:
        """Return the files that one process of the cluster's environment writes."""
        command = [
            str(self.local.python),
            "-c",
            ONE_PROCESS,
            str(self.flow),
            str(self.source),
            str(self.root / "one"),
        ]
        subprocess.run(command, cwd=ROOT, check=True)
        return contents(self.root / "one")


@pytest.fixture
def world(local: Local, tmp_path: Path) -> World:
    """A world with both task managers running."""
    start()
    built = World(local, tmp_path)
    built.flow.write_text(FLOW)
    return built


def until(so: Callable[[], bool], seconds: float = 180) -> None:
    """Wait until a condition is true."""
    limit = time.monotonic() + seconds
    while not so():
        assert time.monotonic() < limit, "timed out"
        time.sleep(0.05)


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}

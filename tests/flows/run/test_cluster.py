"""Replays on a Dask cluster whose parts are killed: `make test-cluster`."""

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from storage.layout import session_folder
from tests.command import SLIPFLOW, slipflow, succeed
from tests.dask_cluster import DaskCluster, kill, two_workers
from tests.flows.run import test_replays
from tests.flows.run.recorder import record
from tests.storage.made import contents, session_names
from tests.waiting import PATIENCE, wait_until

pytestmark = pytest.mark.cluster

FLOW = test_replays.FLOW.replace("TestSource(Touch))", "TestSource(Touch, fingers=(0, 1))) | Slow()")
FLOW += """
import time
from dataclasses import dataclass
from operators import Operator
from pauses import PAUSE

@dataclass
class Slow(Operator[Touch, Touch]):
    def process(self, batch: Touch) -> Touch:
        time.sleep(PAUSE)
        return batch
"""
RECORDINGS = 12


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with recordings and a flow of two files."""
    root = tmp_path_factory.mktemp("lab")
    for number in range(RECORDINGS):
        record(root / "in", f"session-{number:02d}", 15, seed=number)
    (root / "felt.py").write_text(FLOW)
    (root / "pauses.py").write_text("PAUSE = 0.1  # s\n")
    return root


@pytest.fixture(scope="module")
def expected(lab: Path) -> tuple[dict[str, bytes], list[str]]:
    """Files and lines of one process."""
    done = succeed(*command(lab, lab / "one"), "--jobs", "1")
    assert "slip onset" in done.stdout
    return contents(lab / "one"), lines(done.stdout)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    with two_workers(tmp_path) as running:
        yield running


def command(lab: Path, out: Path) -> list[str]:
    return ["run", str(lab / "felt.py"), "--replay", str(lab / "in"), "--set", f"out={out}"]


def lines(printed: str) -> list[str]:
    """Return the printed lines without the last one, which has the wall time."""
    return printed.splitlines()[:-1]


def children(process: subprocess.Popen[bytes]) -> list[int]:
    """Return the processes that compute, which the worker's nanny starts again if they die."""
    found = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(pid) for pid in found if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def test_a_killed_worker_and_a_later_one_change_nothing(
    lab: Path, expected: tuple[dict[str, bytes], list[str]], cluster: DaskCluster, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    arguments = [*SLIPFLOW, *command(lab, out), "--cluster", cluster.url]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        wait_until(lambda: (out / "dataset.json").exists() and len(session_names(out)) > 1)
        for pid in children(cluster.workers[0]):
            os.kill(pid, signal.SIGKILL)
        kill(cluster.workers[1])
        cluster.add_worker()
        printed, errors = running.communicate(timeout=PATIENCE)
    assert running.returncode == 0, errors
    assert (contents(out), lines(printed)) == expected


def test_after_a_killed_scheduler_the_same_command_continues(
    lab: Path, expected: tuple[dict[str, bytes], list[str]], cluster: DaskCluster, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    arguments = [*command(lab, out), "--cluster", cluster.url]
    with subprocess.Popen([*SLIPFLOW, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        wait_until(lambda: (out / "dataset.json").exists() and len(session_names(out)) > 1)
        kill(cluster.scheduler)
        _, errors = running.communicate(timeout=PATIENCE)
    assert running.returncode == 2
    assert b"error: --cluster: the Dask scheduler was lost: when it is back, repeat the command" in errors
    kept = {name: session_folder(out, name).stat().st_ino for name in session_names(out)}
    assert 0 < len(kept) < RECORDINGS
    cluster.start_scheduler(int(cluster.url.rpartition(":")[2]))
    cluster.add_worker()
    done = succeed(*arguments)
    assert f"of {RECORDINGS} replayed already" in done.stderr
    assert contents(out) == expected[0]
    assert {name: session_folder(out, name).stat().st_ino for name in kept} == kept


def test_a_recording_that_kills_its_workers_is_named_and_the_others_are_written(
    lab: Path, cluster: DaskCluster, tmp_path: Path
) -> None:
    deadly = "len(batch) != 100 or __import__('os')._exit(1)"  # its only batch has 100 rows
    flow = FLOW.replace("time.sleep(PAUSE)", deadly).replace("pauses", "no_pauses")
    (tmp_path / "felt.py").write_text(flow)
    (tmp_path / "no_pauses.py").write_text("PAUSE = 0\n")  # `slipflow` may run in this process: another name
    record(tmp_path / "in", "deadly", 1)
    for name, where in (("local", ["--jobs", "2"]), ("dask", ["--cluster", cluster.url])):
        arguments = command(tmp_path, tmp_path / name)
        done = slipflow(*arguments, str(session_folder(lab / "in", "session-03")), *where)
        assert done.returncode == 1, done
        assert "in/sessions/deadly: its " in done.stderr
        assert session_names(tmp_path / name) == ["session-03"]

import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from shutil import rmtree
from threading import Event

import numpy as np
import pytest

from flows.graph.loading import load
from flows.run.cluster.cluster_replay import Cluster
from flows.run.cluster.job_folder import JobFolder
from flows.run.cluster.work_units import WorkUnit

from .conftest import ROOT, Local, Recorder, World, contents, start, stop, until

pytestmark = pytest.mark.cluster


def cluster_of(world: World) -> Cluster:
    return Cluster(world.local.url, world.local.python, slices=2)


def test_operators_import_in_the_environment_of_the_cluster(world: World) -> None:
    code = "import numpy, operators; print(numpy.__version__ < '2.2')"
    done = subprocess.run(
        [world.local.python, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "True"


@pytest.mark.parametrize(("sessions", "fingers", "seconds"), [(2, 3, 60), (1, 64, 20)])
def test_two_task_managers_write_the_files_of_one_process(
    world: World, sessions: int, fingers: int, seconds: int
) -> None:
    world.record(sessions, fingers, seconds)
    cluster, settings = cluster_of(world), {"out": str(world.out)}
    done = cluster.run("job", load(str(world.flow)), settings, [world.source])
    assert done == {f"session-{number}": "" for number in range(sessions)}
    expected = world.expected()
    assert any(path.endswith("slips.parquet") for path in expected)
    assert contents(world.out) == expected
    units = world.local.processed_units(cluster.job)
    assert len(units) == 2
    assert min(units) > 0.4 * sum(units), "one of the two processed most units"


@pytest.mark.parametrize("victim", ["task manager", "python worker", "job manager"])
def test_a_kill_changes_nothing(victim: str, world: World) -> None:
    world.record(sessions=2, fingers=4, seconds=120)
    cluster, local = cluster_of(world), world.local
    with ThreadPoolExecutor() as pool:
        settings = {"out": str(world.out), "pause": "0.1"}
        ended = pool.submit(cluster.run, "job", load(str(world.flow)), settings, [world.source])
        until(lambda: ended.done() or bool(cluster.job))
        assert cluster.job, ended.exception()
        first = cluster.job
        until(lambda: local.checkpoints(first)["completed"] > 1 and sum(local.processed_units(first)) > 0)
        victims = {
            "task manager": local.task_managers,
            "python worker": local.workers,
            "job manager": local.job_managers,
        }
        os.kill(victims[victim]()[0], signal.SIGKILL)
        assert not ended.done(), ended.exception()
        while wait([ended], timeout=5).not_done:  # restart what has died, as Compose does
            start()
        assert ended.result() == {"session-0": "", "session-1": ""}
    assert local.checkpoints(cluster.job)["restored"] >= 1
    assert (cluster.job != first) == (victim == "job manager")
    if victim == "task manager":
        stop()
        assert local.workers() == []
    assert contents(world.out) == world.expected()


def test_stopping_a_cluster_ends_no_worker_of_another(local: Local) -> None:
    code = ["-c", "import time; time.sleep(600)", "pyflink.fn_execution.beam.beam_boot"]
    places = [local.pids.parents[1].with_name("at-1") / "pid", Path("/elsewhere/at-1/pid")]
    workers = [
        subprocess.Popen([sys.executable, *code], env={**os.environ, "FLINK_PID_DIR": str(place)})
        for place in places
    ]
    try:
        subprocess.run(["deploy/cluster", "stop"], cwd=ROOT, env={**os.environ, "PORT": "1"}, check=True)
        assert workers[0].wait(60) == -signal.SIGKILL
        assert workers[1].poll() is None
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()
        rmtree(places[0].parent)


def test_parts_in_any_order_and_repeated_before_and_after_a_savepoint_are_processed_once(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    chance, earlier, repeated = np.random.default_rng(0), list[WorkUnit](), list[WorkUnit]()
    send_units = JobFolder.add_units

    def disordered(folder: JobFolder, name: str, units: Iterable[WorkUnit]) -> None:
        new = list(units)
        again = [each for each in [*earlier, *new] if chance.random() < 0.05] or [new[0]]
        repeated.extend(again)
        earlier.extend(new)
        order: list[int] = chance.permutation(len(new) + len(again)).tolist()
        send_units(folder, name, [[*new, *again][place] for place in order])

    monkeypatch.setattr(JobFolder, "add_units", disordered)
    recorder = Recorder(world.source, "growing", fingers=3)
    recorder.record(70)
    cluster, enough = cluster_of(world), Event()

    def run() -> dict[str, str]:
        declaration, settings = load(str(world.flow)), {"out": str(world.out)}
        return cluster.run("job", declaration, settings, [world.source], follow=True, stopped=enough.is_set)

    def written(session: str) -> Path:
        return world.out / "sessions" / session

    with ThreadPoolExecutor() as pool:
        ended = pool.submit(run)
        until(lambda: ended.done() or bool(cluster.job))
        first, local = cluster.job, world.local
        until(lambda: ended.done() or sum(local.processed_units(first)) > 0)
        assert not ended.done(), ended.exception()
        assert not written("growing").exists()
        local.ask(f"/jobs/{first}/stop", {"targetDirectory": f"file://{world.root}/savepoints"})
        until(lambda: ended.done() or cluster.job != first)
        recorder.record(100)
        recorder.close()
        until(lambda: ended.done() or written("growing").exists())
        world.record(sessions=1, fingers=3, seconds=30)
        until(lambda: ended.done() or written("session-0").exists())
        enough.set()
        assert ended.result(timeout=120) == {"growing": "", "session-0": ""}
    assert repeated
    assert local.checkpoints(cluster.job)["restored"] == 1
    assert contents(world.out) == world.expected()

"""Workers are real processes; what they do stands in a module that they can import."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from flows.run.processes import WorkerPool

WORK = """
import os, signal, sys, time
from pathlib import Path

def work(item, stopped):
    what, _, where = item.partition(":")
    path = Path(where)
    if what == "make":
        path.touch()
    elif what == "await":
        while not path.exists() and not stopped():
            time.sleep(0.01)
    elif what == "die":
        os._exit(3)
    elif what == "wait":
        path.write_text(str(os.getpid()))
        while not stopped():
            time.sleep(0.01)
        return "stopped"
    elif what == "where":
        masked = {signal.SIGINT, signal.SIGTERM} <= signal.pthread_sigmask(signal.SIG_BLOCK, ())
        return [os.getpid(), os.environ.get("OMP_NUM_THREADS"), masked]
    return item
"""


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    (tmp_path / "worked.py").write_text(WORK)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    yield import_module("worked").work
    del sys.modules["worked"]


def lost(item: str, reason: str) -> str:
    return f"{item} {reason}"


def test_processes_work_at_once_and_results_come_in_order(work: Callable[..., Any], tmp_path: Path) -> None:
    items = [f"await:{tmp_path}/there", f"make:{tmp_path}/there", "last"]  # the first needs the second to end
    done = list[int]()
    assert list(WorkerPool(work, items, lost, progress=done.append).results(2)) == items
    assert done == [1, 2, 3]


def test_a_process_that_dies_costs_its_item_only(work: Callable[..., Any]) -> None:
    found = list(WorkerPool(work, ["one", "die", "two", "three"], lost).results(2))
    assert found[0::2] == ["one", "two"]
    assert found[1].startswith("die its process died with exit code 3")
    assert found[3] == "three"


@pytest.mark.parametrize("jobs", [1, 2])
def test_on_a_stop_items_in_progress_return_early_and_the_rest_is_not_started(
    work: Callable[..., Any], tmp_path: Path, jobs: int
) -> None:
    places = [tmp_path / f"begun-{number}" for number in range(jobs)]

    def stopped() -> bool:
        return all(place.exists() for place in places)

    items = [*(f"wait:{place}" for place in places), "rest", "more"]
    found = list(WorkerPool(work, items, lost, stopped).results(jobs))
    assert found == ["stopped"] * jobs + [f"{each} was not started: interrupted" for each in ("rest", "more")]


def test_one_job_runs_in_this_process(work: Callable[..., Any]) -> None:
    done = list[int]()
    [[process, *_], _] = WorkerPool(work, ["where", "more"], lost, progress=done.append).results(1)
    assert (process, done) == (os.getpid(), [1, 2])


def test_a_worker_computes_in_one_thread_and_leaves_signals_to_the_parent(
    work: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    [[process, threads, masked], _] = WorkerPool(work, ["where", "more"], lost).results(2)
    assert (process != os.getpid(), threads, masked) == (True, "1", True)
    assert "OMP_NUM_THREADS" not in os.environ
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_closing_the_results_ends_the_workers(work: Callable[..., Any], tmp_path: Path) -> None:
    results = WorkerPool(work, ["first", f"wait:{tmp_path}/pid", f"wait:{tmp_path}/other"], lost).results(2)
    assert next(results) == "first"
    results.close()  # returns once they have ended
    assert not [path for path in tmp_path.glob("pid") if Path(f"/proc/{path.read_text()}").exists()]


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "worked.py").write_text(WORK)
    script = f"""
import sys
sys.path.insert(0, {str(tmp_path)!r})
from flows.run.processes import WorkerPool
from worked import work
if __name__ == "__main__":
    list(WorkerPool(work, ["wait:{tmp_path}/pid", "wait:{tmp_path}/other"], print).results(2))
"""
    (tmp_path / "parent.py").write_text(script)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py")], env={**os.environ, "PYTHONPATH": str(Path.cwd())}
    ) as parent:
        while not (tmp_path / "pid").exists() or not (pid := (tmp_path / "pid").read_text()):
            assert parent.poll() is None
        parent.kill()
    while Path(f"/proc/{pid}").exists():
        if "zombie" in Path(f"/proc/{pid}/status").read_text():  # not reaped in a container
            break

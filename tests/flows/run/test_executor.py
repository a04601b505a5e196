import os
import signal
import subprocess
import sys
from concurrent.futures import Executor, Future
from pathlib import Path

import pytest

from flows.run.executor import DaskWorkers, map_tasks, one_thread, workers
from operators.errors import EndpointError, SlipflowError
from tests.flows.run.worked import work
from tests.waiting import wait_until


def ended(pid: int) -> bool:
    status = Path(f"/proc/{pid}/status")
    return not status.exists() or "zombie" in status.read_text()  # not reaped in a container


def test_workers_work_at_once_and_results_come_in_order(two: Executor, tmp_path: Path) -> None:
    items = [f"await:{tmp_path}/there", f"make:{tmp_path}/there", "last"]  # the first needs the second to end
    done = list[tuple[int, int]]()
    assert list(map_tasks(work, items, two, progress=lambda *each: done.append(each))) == items
    assert done == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_the_error_of_an_item_is_raised_in_its_turn(two: Executor) -> None:
    results = map_tasks(work, ["one", "fail", "two"], two)
    assert next(results) == "one"
    with pytest.raises(ValueError, match="no number"):
        next(results)


def test_a_process_that_dies_costs_its_item_only() -> None:
    items = ["one", "die", "two", "three"]
    with workers(2) as executor:
        found = list(map_tasks(work, items, executor, lost=lambda item, reason: f"{item} {reason}"))
        assert found[0::2] == ["one", "two"]
        assert found[1].startswith("die its process died, perhaps for lack of memory")
        assert found[3] == "three"
        with pytest.raises(SlipflowError, match=r"^die: its process died"):
            list(map_tasks(work, items, executor))


def test_one_job_or_one_item_runs_in_this_process() -> None:
    with workers(1) as executor:
        assert [each[0] for each in map_tasks(work, ["where", "where"], executor)] == [os.getpid()] * 2
    with workers(2) as executor:
        assert [each[0] for each in map_tasks(work, ["where"], executor)] == [os.getpid()]


def test_a_worker_has_one_thread_and_leaves_signals_to_the_parent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with workers(2) as executor:
        [[process, threads, masked], _] = map_tasks(work, ["where", "where"], executor)
    assert (process != os.getpid(), threads, masked) == (True, "1", True)
    assert "OMP_NUM_THREADS" not in os.environ
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_error_in_the_block_ends_the_workers_in_the_middle_of_a_task(tmp_path: Path) -> None:
    place = tmp_path / "pid"

    def interrupt(done: int, _total: int) -> None:
        if done == 1:
            wait_until(place.exists)
            raise KeyboardInterrupt  # Ctrl-C

    items = ["first", f"wait:{place}", "rest"]
    with pytest.raises(KeyboardInterrupt), workers(2) as executor:
        list(map_tasks(work, items, executor, progress=interrupt))
    assert ended(int(place.read_text()))


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    place = tmp_path / "pid"
    script = f"""
from flows.run.executor import map_tasks, workers
from tests.flows.run.worked import work
if __name__ == "__main__":
    with workers(2) as executor:
        list(map_tasks(work, ["wait:{place}", "wait:{place}-other"], executor))
"""
    (tmp_path / "parent.py").write_text(script)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py")], env={**os.environ, "PYTHONPATH": str(Path.cwd())}
    ) as parent:
        wait_until(place.exists, parent)
        parent.kill()
    wait_until(lambda: ended(int(place.read_text())))


@pytest.mark.parametrize("url", ["tcp://127.0.0.1:1", "127.0.0.1", "http://127.0.0.1:1"])
def test_a_scheduler_that_does_not_answer_is_an_error(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flows.run.executor._CONNECT_TIMEOUT", 0.2)
    if not url.startswith("tcp:"):
        monkeypatch.delattr("distributed.Client")  # with such a URL it takes 20 s to end
    with (
        pytest.raises(EndpointError, match=f"^{url}: the Dask scheduler cannot be reached"),
        workers(cluster=url),
    ):
        pass


def test_libraries_have_one_thread_inside_and_torch_its_former_number_after() -> None:
    torch, pools = pytest.importorskip("torch"), pytest.importorskip("threadpoolctl")
    pytest.importorskip("sklearn")
    had = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with one_thread():
            assert torch.get_num_threads() == 1
            inside = pools.threadpool_info()
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(had)
    assert {pool["num_threads"] for pool in inside} == {1}
    assert {"blas", "openmp"} <= {pool["user_api"] for pool in inside}


def test_a_task_that_never_ends_after_a_scheduler_was_lost_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    class LostCluster:
        status = "closed"

        def get_executor(self, *, pure: bool) -> "LostCluster":
            return self

        def submit(self, work: object, item: object) -> Future[int]:
            return Future[int]()  # its result was on its way

    monkeypatch.setattr("flows.run.executor._CHECK_INTERVAL", 0.01)
    with pytest.raises(EndpointError, match="the Dask scheduler was lost: when it is back, repeat"):
        list(map_tasks(int, ["1"], DaskWorkers(LostCluster())))

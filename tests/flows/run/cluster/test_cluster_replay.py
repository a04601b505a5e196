import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from flows.graph.loading import Declaration, load
from flows.run.cluster.cluster_replay import Cluster
from flows.run.cluster.job_folder import JobFolder
from flows.run.cluster.job_manager import JobManager
from flows.run.cluster.work_units import WorkUnit
from operators import EndpointError, InputError, ParameterError

from .conftest import processed

FLOW = """
from flows.graph import Flow
from flows.graph.testing import TestSource
from operators import Debounce, Score, Touch, Zero
from storage import Dataset, load_detector

def slips(out: str = "out") -> Flow:
    flow = Flow("slips")
    scores = flow.source(TestSource(Touch)) | Zero() | Score(load_detector("psd"))
    (scores | Debounce()).to(Dataset(out))
    return flow
"""


@dataclass
class Manager:
    """Stand-in for a job manager that runs a job when its state is requested."""

    url: str = ""
    out: Path = Path()
    slots: int = 2
    state: str = "FINISHED"
    requests: list[str] = field(default_factory=list[str])

    def answer(self, method: str, path: str) -> dict[str, Any]:
        self.requests.append(f"{method} {path}")
        if path == "/overview":
            return {"slots-total": self.slots}
        if path.endswith("/exceptions"):
            stack = "java.lang.RuntimeException\nCaused by: operators.errors.EndpointError: disk: full\n"
            return {"exceptionHistory": {"entries": [{"stacktrace": stack}]}}
        if path.endswith("/checkpoints"):
            return {"latest": {"completed": {"trigger_timestamp": 1, "external_path": "file:/chk-1"}}}
        if path == "/jobs/overview":
            if self.state == "FINISHED":
                self.run_jobs()
            return {"jobs": [{"jid": "0123abcd", "state": self.state}]}
        return {}

    def run_jobs(self) -> None:
        for place in (self.out / ".jobs").glob("*"):
            folder = JobFolder(place)
            units = [
                WorkUnit.from_line(line)
                for file in sorted(folder.units.iterdir())
                for line in file.read_text().splitlines()
            ]
            for last, shares in processed(folder.flow(), units):
                folder.finish(last, shares)


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    held = Manager(out=tmp_path / "out")

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            data = json.dumps(held.answer(self.command, self.path.partition("?")[0])).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        do_PATCH = do_GET  # noqa: N815 - as http.server has it

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - as http.server has it
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    held.url = f"http://127.0.0.1:{server.server_port}"
    thread = Thread(target=server.serve_forever)
    thread.start()
    yield held
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """Stand-in for a Python with pyflink."""
    path = tmp_path / "python"
    path.write_text('#!/bin/sh\necho "a warning" >&2\necho 0123abcd\n')
    path.chmod(0o755)
    return path


@pytest.fixture
def declaration(tmp_path: Path) -> Declaration:
    path = tmp_path / "slips_flow.py"
    path.write_text(FLOW)
    return load(str(path))


@pytest.fixture
def run(
    manager: Manager, python: Path, declaration: Declaration, tmp_path: Path
) -> Callable[..., dict[str, str]]:
    def start(*paths: Path, stopped: Callable[[], bool] = lambda: False) -> dict[str, str]:
        settings = {"out": str(tmp_path / "out")}
        return Cluster(manager.url, python).run("job", declaration, settings, paths, stopped=stopped)

    return start


def test_a_dataset_is_replayed_and_the_job_folder_removed(
    run: Callable[..., dict[str, str]], folder: Path, tmp_path: Path
) -> None:
    assert run(folder.parents[1]) == {"one": ""}
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["dataset.json", "sessions"]
    assert (tmp_path / "out" / "sessions" / "one" / "slips.parquet").exists()


def test_other_recordings_are_replayed_if_one_is_damaged(
    run: Callable[..., dict[str, str]], new_recorder: Callable[..., Any], folder: Path
) -> None:
    recorder = new_recorder("two")
    recorder.record(5)
    (recorder.close() / "touch" / "part-000000.parquet").unlink()
    done = run(folder.parents[1])
    assert done["one"] == ""
    assert "part-000000.parquet: cannot be read" in done["two"]


def test_the_error_of_a_job_is_raised_even_if_its_folder_cannot_be_removed(
    run: Callable[..., dict[str, str]], manager: Manager, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def remove(self: JobFolder) -> None:
        raise InputError(str(self.path), "is damaged")

    manager.state = "FAILED"
    monkeypatch.setattr(JobFolder, "remove", remove)
    with pytest.raises(EndpointError, match="the job was failed"):
        run(folder)


def test_an_existing_session_is_an_error(run: Callable[..., dict[str, str]], folder: Path) -> None:
    run(folder)
    with pytest.raises(InputError, match="has a session 'one' already"):
        run(folder)


def test_a_missing_recording_is_an_error(run: Callable[..., dict[str, str]], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: there is no such folder"):
        run(tmp_path / "nowhere")


@pytest.mark.parametrize("state", ["FAILED", "CANCELED"])
def test_a_failed_job_is_an_error_with_its_cause(
    state: str, run: Callable[..., dict[str, str]], manager: Manager, folder: Path, tmp_path: Path
) -> None:
    manager.state = state
    with pytest.raises(EndpointError, match=f"the job was {state.lower()}: EndpointError: disk: full"):
        run(folder)
    assert not (tmp_path / "out" / ".jobs").exists()


def test_stopping_cancels_the_job(run: Callable[..., dict[str, str]], manager: Manager, folder: Path) -> None:
    manager.state = "RUNNING"
    assert run(folder, stopped=lambda: True) == {}
    assert manager.requests[-1] == "PATCH /jobs/0123abcd"


def test_a_cluster_without_task_managers_is_an_error(
    run: Callable[..., dict[str, str]], manager: Manager, folder: Path
) -> None:
    manager.slots = 0
    with pytest.raises(EndpointError, match="has no task manager"):
        run(folder)


def test_a_failed_submission_is_an_error_with_its_cause(
    manager: Manager, declaration: Declaration, folder: Path, tmp_path: Path
) -> None:
    python = tmp_path / "broken"
    python.write_text('#!/bin/sh\necho "ModuleNotFoundError: No module named pyflink" >&2\nexit 1\n')
    python.chmod(0o755)
    with pytest.raises(EndpointError, match="cannot be submitted: ModuleNotFoundError"):
        Cluster(manager.url, python).run("job", declaration, {"out": str(tmp_path / "out")}, [folder])


def test_a_missing_job_manager_is_an_error_with_the_fix() -> None:
    with pytest.raises(EndpointError, match="make cluster"):
        JobManager("http://127.0.0.1:9").slots()


@pytest.mark.parametrize("url", ["localhost:8081", "file:///etc/passwd", ""])
def test_an_invalid_url_is_an_error(url: str) -> None:
    with pytest.raises(ParameterError, match="such as http://localhost:8081"):
        JobManager(url)

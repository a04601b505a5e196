"""Dask scheduler and workers of their own processes, on this machine only."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import distributed

from tests.waiting import PATIENCE

Client: Any = distributed.Client
DASK = Path(sys.executable).with_name("dask")


@dataclass
class DaskCluster:
    """Scheduler and workers with one thread each, which log into a folder."""

    folder: Path
    url: str = field(default="", init=False)
    scheduler: subprocess.Popen[bytes] = field(init=False)
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list[subprocess.Popen[bytes]], init=False)

    def __enter__(self) -> Self:
        self.start_scheduler()
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            kill(process)

    def start_scheduler(self, port: int = 0) -> None:
        """Start a scheduler and wait until it listens."""
        self.scheduler = self._start("scheduler", "--port", str(port), "--no-show")
        while not (found := re.search(r"Scheduler at:\s+(tcp://\S+)", self._log("scheduler"))):
            assert self.scheduler.poll() is None, self._log("scheduler")
        self.url = found[1]

    def add_worker(self) -> None:
        """Start a worker, which restarts when it is killed."""
        arguments = self.url, "--nthreads", "1", "--local-directory", str(self.folder)
        self.workers.append(self._start("worker", *arguments))

    def _start(self, kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [str(DASK), kind, "--host", "127.0.0.1", "--no-dashboard", *arguments]
        with (self.folder / f"{kind}.log").open("ab") as log:
            environment = {**os.environ, "PYTHONPATH": str(Path.cwd())}  # tests send their own functions
            return subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True, env=environment)

    def _log(self, kind: str) -> str:
        return (self.folder / f"{kind}.log").read_text()


def kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and those that it started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@contextmanager
def two_workers(folder: Path) -> Generator[DaskCluster]:
    """Start a scheduler and two workers."""
    with DaskCluster(folder) as cluster:
        cluster.add_worker()
        cluster.add_worker()
        with Client(cluster.url, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=PATIENCE)
        yield cluster

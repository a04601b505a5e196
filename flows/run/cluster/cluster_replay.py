"""Replay of recordings on a cluster: send work units, submit the job, and monitor it to its end."""

import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import sleep
from typing import Final

from flows.graph import Flow
from flows.graph.loading import Declaration
from flows.run.cluster.job_folder import JobFolder
from flows.run.cluster.job_manager import ENDED, LOST, JobManager
from flows.run.cluster.splitting import Splitter, check_flow
from flows.run.log_events import warn
from flows.run.parallel_replay import recordings
from operators.errors import EndpointError, InputError, ParameterError, SlipflowError, os_error_reason
from operators.ports import Sink
from storage.layout import SESSION, session_folder, session_names

PYTHON: Final = Path(".cluster/bin/python")  # created by deploy/cluster
_INTERVAL: Final = 1.0  # s, between checks of the job and of growing recordings
_MISSED: Final = 120  # consecutive checks without a response of the job manager before it is an error


@dataclass
class Cluster:
    """One replay of recordings through a flow on a Flink cluster.

    Args:
        url: URL of the job manager.
        python: Python that has pyflink, at the same path on all machines; None: this one if it has, else
            the one of `deploy/cluster`.
        slices: Slices per work unit.
        workers: Number of workers; None: all task slots.
    """

    url: str
    python: Path | None = None
    slices: int = 16
    workers: int | None = None
    job: str = field(default="", init=False)  # Flink's id, after submission

    def run(
        self,
        name: str,
        declaration: Declaration,
        settings: Mapping[str, str],
        paths: Sequence[Path],
        *,
        follow: bool = False,
        stopped: Callable[[], bool] = lambda: False,
        progress: Callable[[int, int], object] = lambda _done, _of: None,
    ) -> dict[str, str]:
        """Replay all recordings; each becomes a session of the same name.

        Args:
            name: Name of the job, a file name.
            declaration: Declaration of the flow.
            settings: Parameters of the flow, as text.
            paths: Sessions, or datasets for all of their sessions.
            follow: Continue with new recordings until stopped.
            stopped: Returns true to stop: unfinished sessions are omitted; when following, those whose
                recording has ended are still written.
            progress: Called with the number of finished sessions and of all sessions.

        Returns:
            The finished sessions by name, each with its error; empty: no error.

        Raises:
            FlowError: if the flow cannot run on a cluster.
            InputError: if there is no recording.
            EndpointError: if the cluster or a dataset cannot be reached, or the job failed.
        """
        flow = declaration.flow(settings)
        check_flow(flow)
        manager, python = JobManager(self.url), self._python()
        workers = manager.slots() if self.workers is None else self.workers
        if workers < 1:
            raise EndpointError(self.url, "has no task manager: start one, or try again when it has joined")
        feed = UnitFeed(flow, paths, follow=follow, slices=self.slices, shares=workers)
        feed.find_recordings()
        folder = JobFolder.create(name, declaration, settings, flow)
        try:
            feed.send_units(folder)
            submit = partial(_submit, python, self.url, folder, workers, follow=follow)
            self.job = submit(None)
            return self._watch(manager, feed, folder, submit, stopped=stopped, progress=progress)
        finally:
            with suppress(EndpointError):
                if self.job and manager.state(self.job) not in ENDED:
                    manager.cancel(self.job)
            with suppress(SlipflowError):  # an earlier error is more important
                folder.remove()

    def _watch(
        self,
        manager: JobManager,
        feed: "UnitFeed",
        folder: JobFolder,
        submit: Callable[[str | None], str],
        *,
        stopped: Callable[[], bool],
        progress: Callable[[int, int], object],
    ) -> dict[str, str]:
        """Monitor the job to its end; submit it again if it is lost, or was stopped with a savepoint."""
        missed = 0  # consecutive checks without a response
        restore: str | None = None  # newest checkpoint or savepoint
        while True:
            try:
                state = manager.state(self.job)
                if state != LOST:
                    restore = manager.restore_point(self.job) or restore
                missed = 0
            except EndpointError:
                missed += 1
                if missed == _MISSED:
                    raise
                sleep(_INTERVAL)
                continue
            done = feed.failed | folder.done()
            progress(len(done), len(feed.splitters))
            unfinished = feed.follow or len(done) < len(feed.splitters)
            if stopped() and not (feed.follow and feed.ended - done.keys()):
                return done
            if state == LOST or (state == "FINISHED" and unfinished):
                restore = restore if state == LOST else self._savepoint(manager)
                warn("job_resumed", f"Flink job {self.job} continues as a new job", restore=restore)
                self.job = submit(restore)
            elif state == "FINISHED":
                return done
            elif state in ENDED:
                reason = f"the job was {state.lower()}: {manager.cause(self.job)}"
                raise EndpointError(self.url, reason)
            if feed.follow and not stopped():
                feed.find_recordings()
                feed.send_units(folder)
            sleep(_INTERVAL)

    def _savepoint(self, manager: JobManager) -> str:
        """Return the savepoint with which the job was stopped; Flink has deleted its checkpoints.

        Raises:
            EndpointError: if the job manager does not respond, or there is none.
        """
        for _ in range(_MISSED):
            if path := manager.savepoint(self.job):
                return path
            sleep(_INTERVAL)  # Flink reports it some seconds after the end of the job
        raise EndpointError(self.url, "the job has ended without a savepoint")

    def _python(self) -> Path:
        if self.python:
            return self.python
        if find_spec("pyflink"):
            return Path(sys.executable)
        if PYTHON.exists():
            return PYTHON.absolute()
        raise ParameterError(
            "cluster",
            "python",
            sys.executable,
            f"a Python with pyflink, or {PYTHON}, which `make cluster` creates",
        )


@dataclass
class UnitFeed:
    """Recordings to replay, and the work units sent so far."""

    flow: Flow
    paths: Sequence[Path]
    follow: bool
    slices: int
    shares: int
    splitters: dict[str, Splitter] = field(default_factory=dict[str, Splitter], init=False)  # by session
    failed: dict[str, str] = field(default_factory=dict[str, str], init=False)  # errors by session
    _files: int = field(default=0, init=False)

    @property
    def ended(self) -> set[str]:
        """Sessions whose units are all sent."""
        return {name for name, splitter in self.splitters.items() if splitter.ended}

    def find_recordings(self) -> None:
        """Find new recordings.

        Raises:
            InputError: if there are none, two have the same name, or a dataset has a session of that name.
        """
        datasets = [Path(node.part.destination) for node in self.flow.sinks() if isinstance(node.part, Sink)]
        for folder in [folder for path in self.paths for folder in _sessions(path, follow=self.follow)]:
            name = folder.name
            if name in self.splitters:
                if self.splitters[name].folder != folder.resolve():
                    raise InputError(
                        str(folder),
                        f"has the same name as {self.splitters[name].folder}: replay only one of them",
                    )
                continue
            existing = [root for root in datasets if session_folder(root, name).exists()]
            if existing and not self.follow:
                raise InputError(str(existing[0]), f"has a session {name!r} already: use another dataset")
            if not existing:
                self.splitters[name] = Splitter(
                    self.flow,
                    folder.resolve(),
                    slices=self.slices,
                    shares=self.shares,
                    number=len(self.splitters),
                )
        if not self.splitters and not self.follow:
            raise InputError(", ".join(map(str, self.paths)), "has no session")

    def send_units(self, folder: JobFolder) -> None:
        """Send new units to the cluster; add recordings that cannot be read to `failed`.

        Raises:
            EndpointError: if the units cannot be written.
        """
        for name, splitter in self.splitters.items():
            if name in self.failed:
                continue
            try:
                units = splitter.units(growing=self.follow)
            except EndpointError:
                raise
            except SlipflowError as error:
                self.failed[name] = str(error)
                continue
            if units:
                self._files += 1
                folder.add_units(f"{self._files:08d}", units)


def _sessions(path: Path, *, follow: bool) -> list[Path]:
    """Return a session, or all sessions of a dataset, which may not exist yet if `follow` is set."""
    if follow and not (path / SESSION).exists():
        return [session_folder(path, name) for name in session_names(path)] if path.exists() else []
    if not path.exists():
        raise InputError(str(path), "there is no such folder")
    return recordings([path])


def _submit(
    python: Path, url: str, folder: JobFolder, workers: int, restore: str | None, *, follow: bool
) -> str:
    """Submit the job with a Python that has pyflink; return Flink's id of the job."""
    command = [str(python), "-m", "flows.run.cluster.flink_job", url, str(folder.path), str(workers)]
    command += ["--follow"] * follow + (["--restore", restore] if restore else [])
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            command, capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise EndpointError(str(python), f"cannot be run: {os_error_reason(error)}") from error
    if done.returncode or not done.stdout.strip():
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        causes = [line.strip() for line in lines if "Caused by:" in line or "Error" in line]
        reason = (causes or lines or ["no message"])[-1]
        raise EndpointError(url, f"the job cannot be submitted: {reason}")
    return done.stdout.split()[-1]

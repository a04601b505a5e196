"""Running a flow over recordings on a cluster: hand out claims, submit the job, watch it to its end."""

import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from time import sleep
from typing import Final

from flows.graph import Flow
from flows.graph.loading import Declaration
from flows.run.cluster.cluster_segment import check_flow
from flows.run.cluster.cutting import Cutter
from flows.run.cluster.job_folder import JobFolder
from flows.run.cluster.job_manager import ENDED, JobManager
from operators.errors import EndpointError, InputError, ParameterError, SlipflowError, os_error_reason
from operators.ports import Sink
from storage.layout import SESSION, SESSIONS, session_folder, session_names

PYTHON: Final = Path(".cluster/bin/python")  # what deploy/cluster makes
_SHARES: Final = 2  # of the fingertips of a session, for each worker
_EVERY: Final = 1.0  # s, between two looks at the job and at what is recorded
_PATIENCE: Final = 30  # looks in a row that a job manager may not answer


@dataclass
class Cluster:
    """One run of a flow over recordings on a Flink cluster.

    Args:
        url: Of the cluster's job manager.
        python: The Python that has pyflink, on this machine and on the cluster's; None: this one, or that of
            `deploy/cluster`.
        slices: That travel as one claim.
        workers: How many share the work; None: as many as there are.
    """

    url: str
    python: Path | None = None
    slices: int = 8
    workers: int | None = None
    job: str = field(default="", init=False)  # Flink's id, once it is submitted

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
        """Run to the end of all recordings; each becomes a session of its own name.

        Args:
            name: Of the job, a file name.
            declaration: Where the flow is from.
            settings: Its parameters, as text.
            paths: Sessions, or datasets for all of their sessions.
            follow: Whether to go on with what is recorded meanwhile, until stopped.
            stopped: Whether to stop: what is not worked out by then is left out, but sessions that
                have ended are still written when following.
            progress: Told how many sessions are done, of how many.

        Returns:
            The sessions that are done, by name, each with its error; empty where there was none.

        Raises:
            FlowError: if the flow cannot run on a cluster.
            InputError: if there is nothing to run over.
            EndpointError: if the cluster or a dataset cannot be reached, or the job failed.
        """
        flow = declaration.flow(settings)
        check_flow(flow)
        manager, python = JobManager(self.url), self._python()
        workers = manager.slots() if self.workers is None else self.workers
        if workers < 1:
            raise EndpointError(
                self.url,
                "has no task manager, so nothing can run: start one, or try again when it has joined",
            )
        shares = _SHARES * workers
        feed = Feed(flow, paths, follow=follow, slices=self.slices, shares=shares)
        feed.look()
        folder = JobFolder.create(name, declaration, settings, flow)
        try:
            feed.hand_out(folder)
            self.job = _submitted(python, self.url, folder, workers, follow=follow)
            return self._watch(manager, feed, folder, follow=follow, stopped=stopped, progress=progress)
        finally:
            with suppress(EndpointError):
                if self.job and manager.state(self.job) not in ENDED:
                    manager.cancel(self.job)
            folder.remove()

    def _watch(
        self,
        manager: JobManager,
        feed: "Feed",
        folder: JobFolder,
        *,
        follow: bool,
        stopped: Callable[[], bool],
        progress: Callable[[int, int], object],
    ) -> dict[str, str]:
        missed = 0  # answers in a row
        while True:
            try:
                state, missed = manager.state(self.job), 0
            except EndpointError:
                missed += 1
                if missed == _PATIENCE:
                    raise
                sleep(_EVERY)
                continue
            done = feed.failed | folder.done()
            progress(len(done), len(feed.cutters))
            if state == "FINISHED" or (stopped() and not (follow and feed.ended - done.keys())):
                return done
            if state in ENDED:
                reason = f"the job was {state.lower()}: {manager.cause(self.job)}"
                raise EndpointError(self.url, reason)
            if follow and not stopped():
                feed.look()
                feed.hand_out(folder)
            sleep(_EVERY)

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
            f"one that has pyflink, or {PYTHON}, which `make cluster` sets up",
        )


@dataclass
class Feed:
    """What there is to run over, and how far it is handed out."""

    flow: Flow
    paths: Sequence[Path]
    follow: bool
    slices: int
    shares: int
    cutters: dict[str, Cutter] = field(default_factory=dict[str, Cutter], init=False)  # by session
    failed: dict[str, str] = field(default_factory=dict[str, str], init=False)  # why, by session
    _files: int = field(default=0, init=False)

    @property
    def ended(self) -> set[str]:
        """The sessions of which all is handed out."""
        return {name for name, cutter in self.cutters.items() if cutter.ended}

    def look(self) -> None:
        """See which recordings there are.

        Raises:
            InputError: if there are none, or two of one name, or one has been worked out before.
        """
        places = [Path(node.part.destination) for node in self.flow.sinks() if isinstance(node.part, Sink)]
        for folder in [folder for path in self.paths for folder in _sessions(path, follow=self.follow)]:
            name = folder.name
            if name in self.cutters:
                if self.cutters[name].folder != folder.resolve():
                    raise InputError(
                        str(folder),
                        f"{self.cutters[name].folder} has the same name: run over them one after the other",
                    )
                continue
            there = [place for place in places if session_folder(place, name).exists()]
            if there and not self.follow:
                raise InputError(str(there[0]), f"has a session {name!r} already; give another dataset")
            if not there:
                self.cutters[name] = Cutter(
                    self.flow,
                    folder.resolve(),
                    slices=self.slices,
                    shares=self.shares,
                    deal=len(self.cutters),
                )
        if not self.cutters and not self.follow:
            raise InputError(", ".join(map(str, self.paths)), "holds no session")

    def hand_out(self, folder: JobFolder) -> None:
        """Give the cluster the claims that are new; a recording that cannot be read is noted in `failed`.

        Raises:
            EndpointError: if the claims cannot be written.
        """
        for name, cutter in self.cutters.items():
            if name in self.failed:
                continue
            try:
                claims = cutter.claims(growing=self.follow)
            except EndpointError:
                raise
            except SlipflowError as error:
                self.failed[name] = str(error)
                continue
            if claims:
                self._files += 1
                folder.claim(f"{self._files:08d}", claims)


def _sessions(path: Path, *, follow: bool) -> list[Path]:
    if (path / SESSION).exists():
        return [path]
    if (path / SESSIONS).is_dir():
        return [session_folder(path, name) for name in session_names(path)]
    if follow and not path.exists():
        return []
    raise InputError(
        str(path), "is no session and no dataset" if path.exists() else "there is no such folder"
    )


def _submitted(python: Path, url: str, folder: JobFolder, workers: int, *, follow: bool) -> str:
    """The id of the job, submitted by a Python that has pyflink."""
    command = [str(python), "-m", "flows.run.cluster.flink_job", url, str(folder.path), str(workers)]
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            [*command, "--follow"] if follow else command, capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise EndpointError(str(python), f"cannot be run: {os_error_reason(error)}") from error
    if done.returncode or not done.stdout.strip():
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        causes = [line.strip() for line in lines if "Caused by:" in line or "Error" in line]
        reason = (causes or lines or ["it says nothing"])[-1]
        raise EndpointError(url, f"the job cannot be submitted: {reason}")
    return done.stdout.split()[-1]

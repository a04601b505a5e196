"""Replays of many recordings in parallel, each into its own session."""

import asyncio
import logging
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field, fields
from functools import cached_property
from io import StringIO
from pathlib import Path

from flows.graph import Flow
from flows.graph.loading import load
from flows.graph.validation import validate
from flows.run.processes import Stopped, WorkerPool
from flows.run.replay_runner import ReplayRunner, log_replay_destinations
from flows.run.run_summary import Summary
from operators.errors import InputError, ParameterError, SlipflowError
from operators.ports import Recording, Sink
from storage import Dataset, Session
from storage.layout import SESSION, SESSIONS, session_folder, session_names

log = logging.getLogger("slipflow")


@dataclass(frozen=True)
class Replayed:
    """Result of one replay."""

    recording: str  # path
    summary: Summary | None  # None: not started
    printed: str = field(default="", repr=False)  # output of the sinks
    error: str = ""  # reason of an early end; empty: none


@dataclass(eq=False)
class Replays:
    """Replays of one flow over many recordings.

    Each process builds the flow and its event loop once, since neither can be pickled.

    Args:
        target: Flow, as `flows.graph.loading.load` takes it.
        settings: Parameters of the flow, as text.
        recordings: Sessions or traces; `recordings` finds those of datasets.
        session: Prefix of the session names; a number follows.
    """

    target: str
    settings: Mapping[str, str]
    recordings: Sequence[Path]
    session: str

    def __getstate__(self) -> dict[str, object]:
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def flow(self) -> Flow:
        """Flow of this process.

        Raises:
            SlipflowError: if it cannot be built.
        """
        return load(self.target).flow(self.settings)

    @cached_property
    def _loop(self) -> asyncio.Runner:
        return asyncio.Runner()

    @property
    def exclusive_sinks(self) -> list[str]:
        """Sinks that only one process at a time may write to."""
        return [n.name for n in self.flow.sinks() if isinstance(n.part, Sink) and not n.part.shared]

    def run(
        self,
        jobs: int | None = None,
        *,
        stopped: Stopped = lambda: False,
        progress: Callable[[int], object] = lambda _done: None,
    ) -> Generator[Replayed]:
        """Replay all recordings and yield the results in order; they do not depend on `jobs`.

        A recording that fails does not affect the others.

        Args:
            jobs: Number of processes; None: one per core, or one if a sink is exclusive.
            stopped: Returns True to stop; sessions are then committed as incomplete.
            progress: Called with the number of finished recordings.

        Raises:
            ParameterError: if `jobs` is below 1, or above 1 with an exclusive sink.
            SlipflowError: if the flow cannot be built.
        """
        if exclusive := self.exclusive_sinks:
            if jobs not in (None, 1):
                must_be = f"1: {', '.join(exclusive)} cannot be shared by processes"
                raise ParameterError("replay", "jobs", jobs, must_be)
            jobs = 1
        log_replay_destinations(self.flow)
        width = len(str(len(self.recordings)))
        tasks = [(path, f"{self.session}-{n:0{width}d}") for n, path in enumerate(self.recordings, 1)]
        try:
            yield from WorkerPool(self._replay, tasks, _lost, stopped, progress).results(jobs)
        finally:
            self._loop.close()
            del self._loop

    def _replay(self, task: tuple[Path, str], stopped: Stopped) -> Replayed:
        """Replay one recording; any error becomes part of the result."""
        path, session = task
        runner, printed, error = None, StringIO(), ""
        try:
            with redirect_stdout(printed):
                runner = ReplayRunner(self.flow, open_recording(path, log.warning), session)
                self._loop.run(runner.execute(lambda _: stopped()))
            error = runner.run.error
        except SlipflowError as failure:
            error = str(failure)
        except Exception as failure:
            log.exception("%s", path)
            error = f"{type(failure).__name__}: {failure}"
        summary = None if runner is None else Summary.of(runner.run)
        return Replayed(str(path), summary, printed.getvalue(), error)


def recordings(paths: Iterable[Path]) -> list[Path]:
    """Return the sessions and traces in `paths`; a dataset is replaced by all of its sessions, sorted.

    Raises:
        InputError: if a dataset has no session.
    """
    found = list[Path]()
    for path in paths:
        if path.suffix == ".csv" or (path / SESSION).exists() or not (path / SESSIONS).is_dir():
            found.append(path)  # opening reports the error if it is not a recording
        elif names := session_names(path):
            found += [session_folder(path, name) for name in names]
        else:
            raise InputError(str(path), "has no session: give a dataset, a session's folder, or a trace")
    return found


def check_outputs(flow: Flow, paths: Iterable[Path]) -> None:
    """Check that a flow is valid and does not record into a dataset that it replays.

    The fingertips of its sources are checked for a live run only: a replay has those of its recordings.

    Raises:
        FlowError: if the flow is wired wrongly.
        InputError: if a recording is in the dataset of a sink.
    """
    paths = list(paths)
    validate(flow, fingertips=not paths)
    written = {Path(node.part.destination) for node in flow.sinks() if isinstance(node.part, Dataset)}
    for path in paths:
        if written & set(path.resolve().parents):
            raise InputError(str(path), "is in the dataset that the flow records into: choose another folder")


def open_recording(path: Path, warn: Callable[[str], object]) -> Recording:
    """Open a session or a trace in a file; report warnings about a trace with `warn`.

    Raises:
        InputError: if it is neither, or damaged.
    """
    from connectors.files.container import ENDINGS  # noqa: PLC0415 - slow import, rarely needed
    from connectors.files.trace import Trace  # noqa: PLC0415 - slow import, rarely needed

    if not path.name.endswith(ENDINGS):
        return Session.open(path)

    try:
        trace = Trace(path)
    except InputError as error:
        reason = f"{error.reason} (convert it with slipflow import --map, then replay the result)"
        raise InputError(error.where, reason) from error
    for each in trace.warnings:
        warn(f"warning: {path}: {each} (slipflow import --map states units)")
    return trace


def _lost(task: tuple[Path, str], reason: str) -> Replayed:
    return Replayed(str(task[0]), None, error=reason)

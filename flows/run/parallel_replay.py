"""Replays of many recordings: each to a session of its own, several at once, on the cores of one machine."""

import asyncio
import logging
import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from functools import partial
from io import StringIO
from pathlib import Path

from flows.graph import Flow
from flows.graph.loading import load
from flows.graph.validation import validate
from flows.run.processes import Spread, Watch
from flows.run.replay_runner import ReplayRunner, tell_places
from flows.run.run_summary import Summary
from operators.errors import InputError, ParameterError, SlipflowError
from operators.ports import Recording, Run, Sink
from storage import Dataset, Session
from storage.layout import SESSION, SESSIONS, session_folder, session_names

log = logging.getLogger("slipflow")


@dataclass(frozen=True)
class Replayed:
    """What came of one recording."""

    recording: str  # its path
    summary: Summary | None  # None: it was not begun
    printed: str = field(default="", repr=False)  # by the sinks
    error: str = ""  # why it ended early; empty: it did not


@dataclass(frozen=True)
class Replays:
    """A flow over many recordings.

    The flow is built anew for each, in the process that replays it: flows do not travel between processes,
    nor do what its sinks hold open.

    Args:
        target: The flow, as `flows.graph.loading.load` takes it.
        settings: Its parameters, as text.
        recordings: Sessions or CSV traces, in order; `recordings` finds those of datasets.
        session: What the sessions to be written are called, a number after it.
    """

    target: str
    settings: Mapping[str, str]
    recordings: Sequence[Path]
    session: str

    def lonely(self) -> list[str]:
        """The sinks that only one process may write to at a time.

        Raises:
            SlipflowError: if the flow cannot be built.
        """
        return _lonely(load(self.target).flow(self.settings))

    def run(
        self,
        jobs: int | None = None,
        *,
        stopped: Callable[[], bool] = lambda: False,
        progress: Callable[[int, int], object] = lambda _done, _rows: None,
    ) -> Generator[Replayed]:
        """Replay them all; the results come in the order of the recordings and are the same for any `jobs`.

        A recording that fails keeps no other from being replayed.

        Args:
            jobs: Processes; None: one for each of the machine's cores, or one if a sink needs it.
            stopped: Whether to stop: sessions are committed as far as they are, and are not complete.
            progress: Told how many recordings are done, and how many rows all sources have given.

        Raises:
            ParameterError: on fewer than one job, or several where a sink needs to be alone.
            SlipflowError: if the flow cannot be built.
        """
        flow = load(self.target).flow(self.settings)
        lonely = _lonely(flow)
        if jobs is None:
            jobs = 1 if lonely else os.cpu_count() or 1
        if jobs < 1 or (jobs > 1 and lonely):
            must_be = f"1: {', '.join(lonely)} cannot be shared by processes" if lonely else "at least 1"
            raise ParameterError("replay", "jobs", jobs, must_be)
        tell_places(flow)
        width = len(str(len(self.recordings)))
        tasks = [(path, f"{self.session}-{n:0{width}d}") for n, path in enumerate(self.recordings, 1)]
        work = partial(_replay, self.target, dict(self.settings))
        yield from Spread(work, tasks, _lost, stopped, progress).results(jobs)


def recordings(paths: Iterable[Path]) -> list[Path]:
    """The sessions and CSV traces that paths name; a dataset names all of its sessions, sorted.

    Raises:
        InputError: if a path is none of these, or a dataset holds no session.
    """
    found = list[Path]()
    for path in paths:
        if path.suffix == ".csv" or (path / SESSION).exists() or not (path / SESSIONS).is_dir():
            found.append(path)  # opening it says what is wrong if it is no recording
        elif names := session_names(path):
            found += [session_folder(path, name) for name in names]
        else:
            raise InputError(
                str(path), "holds no session: give a dataset, the folder of a session, or a CSV trace"
            )
    return found


def apart(flow: Flow, paths: Iterable[Path]) -> None:
    """Make sure that a flow is sound and records into no dataset that it is replayed from.

    Raises:
        FlowError: if the flow is wired wrongly.
        InputError: if a recording is in the dataset of one of its sinks.
    """
    validate(flow)
    written = {Path(node.part.destination) for node in flow.sinks() if isinstance(node.part, Dataset)}
    for path in paths:
        if written & set(path.resolve().parents):
            reason = "is in the dataset that the flow records into: give that another folder"
            raise InputError(str(path), reason)


def open_recording(path: Path, doubt: Callable[[str], object]) -> Recording:
    """A session, or a CSV trace; `doubt` is told what is odd about that.

    Raises:
        InputError: if it is none, or damaged.
    """
    if path.suffix != ".csv":
        return Session.open(path)
    from connectors.files.csv_trace import CsvTrace  # noqa: PLC0415 - takes its time to import, and is rare

    try:
        trace = CsvTrace(path)
    except InputError as error:
        told = f"{error.reason} (slipflow import has --map; then replay what it made)"
        raise InputError(error.where, told) from error
    for each in trace.doubts:
        doubt(f"warning: {path}: {each} (slipflow import knows --units)")
    return trace


def _lonely(flow: Flow) -> list[str]:
    return [node.name for node in flow.sinks() if isinstance(node.part, Sink) and not node.part.shared]


def _replay(target: str, settings: Mapping[str, str], task: tuple[Path, str], watch: Watch) -> Replayed:
    """Replay one of many; whatever goes wrong is its own."""
    path, session = task
    runner, printed, error = None, StringIO(), ""
    try:
        with redirect_stdout(printed):
            runner = ReplayRunner(load(target).flow(settings), open_recording(path, log.warning), session)
            asyncio.run(runner.execute(partial(_follow, runner, watch)))
        error = runner.run.error
    except SlipflowError as failure:
        error = str(failure)
    except Exception as failure:
        log.exception("%s", path)
        error = f"{type(failure).__name__}: {failure}"
    summary = None if runner is None else Summary.of(runner.run)
    return Replayed(str(path), summary, printed.getvalue(), error)


def _follow(runner: ReplayRunner, watch: Watch, run: Run) -> None:
    if watch(sum(source.rows for source in run.sources.values())):
        runner.stop()


def _lost(task: tuple[Path, str], reason: str) -> Replayed:
    return Replayed(str(task[0]), None, error=reason)

"""Replays of many recordings, each a task that writes a session of the recording's name.

A task writes the session into a temporary folder of the dataset and moves it when it is complete. So a task
can be repeated, on any machine, and an interrupted command continues with the missing sessions.
"""

import asyncio
import logging
import sys
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, chdir, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib import invalidate_caches
from io import StringIO
from os.path import abspath
from pathlib import Path
from re import sub
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Final

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.loading import flow_files, load
from flows.graph.node import Node
from flows.graph.validation import validate
from flows.run.executor import LocalProcesses, map_tasks
from flows.run.failures import reason_of
from flows.run.replay_runner import ReplayRunner, check_sinks_of_replay, declaration, first_time, replayed
from flows.run.run_summary import Summary
from flows.run.session_output import new_session, remove_partial
from operators.errors import FlowError, InputError, SlipflowError
from operators.ports import Recording
from storage import Dataset, Session
from storage.layout import SESSION, SESSIONS, session_folder, session_folders

_UNPACKED: Final = list[TemporaryDirectory[str]]()  # the folder of the flow files that this process received
_LOCK: Final = Lock()  # tasks share standard output and the working folder of their process

log = logging.getLogger("slipflow")


@dataclass(frozen=True)
class FlowSource:
    """Flow as any process can build it.

    Args:
        target: Flow, as `flows.graph.loading.load` takes it.
        settings: Parameters of the flow, as text.
        files: The flow file and the modules next to it that it imports, by their paths in its folder; empty:
            they are read from `target`.
        directory: Folder that relative paths refer to.
    """

    target: str
    settings: tuple[tuple[str, str], ...] = ()
    files: tuple[tuple[str, bytes], ...] = ()
    directory: str = field(default_factory=lambda: str(Path.cwd()))

    def with_files(self) -> "FlowSource":
        """Return this flow, which was built here, with its files; a shipped flow needs none."""
        declaration = load(self.target)
        if not (files := flow_files(declaration.file)):
            return self
        target = f"{declaration.file.name}:{declaration.name}"
        return FlowSource(target, self.settings, files, self.directory)

    @lru_cache(maxsize=1)  # noqa: B019 - one flow per process: the command's or the worker's
    def flow(self) -> Flow:
        """Build the flow, once per process."""
        folder = self._unpack() if self.files else ""
        return load(folder + self.target).flow(dict(self.settings))

    def _unpack(self) -> str:
        """Write the files into a new folder; forget those received earlier, which may be older."""
        while _UNPACKED:
            with _UNPACKED.pop() as old:
                sys.path[:] = [each for each in sys.path if each != old]
                for name, module in [*sys.modules.items()]:
                    if (getattr(module, "__file__", None) or "").startswith(f"{old}/"):
                        del sys.modules[name]
        folder = TemporaryDirectory(prefix="slipflow-flow-")
        _UNPACKED.append(folder)
        for name, content in self.files:
            path = Path(folder.name, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        invalidate_caches()
        return f"{folder.name}/"


@dataclass(frozen=True)
class Replayed:
    """Result of one replay."""

    recording: str  # path
    summary: Summary | None  # None: not started
    printed: str = field(default="", repr=False)  # output of the sinks
    error: str = ""  # reason of a failure; empty: none


class Replays:
    """Replays of one flow over sessions, traces, and all sessions of datasets.

    Attributes:
        flow: Flow of this process.
        recordings: Recordings to replay, in order.
        existing: Recordings whose sessions are in the datasets already.

    Raises:
        FlowError: if the flow is wired wrongly.
        InputError: if a dataset has no session, is also the output, or has another session of a recording's
            name; if two recordings have the same name.
        SlipflowError: if the flow cannot be built.
    """

    def __init__(self, source: FlowSource, paths: Iterable[Path]) -> None:
        self._source, self.flow = source, source.flow()
        found = recordings(paths)
        check_outputs(self.flow, found)
        self._roots = [*_roots(self.flow).values()]
        if self._roots:
            _check_names(found)
        self.existing = [path for path in found if self._exists(path)]
        self.recordings = [path for path in found if path not in self.existing]

    @property
    def exclusive_sinks(self) -> list[str]:
        """Sinks that only one process at a time may write to."""
        return [node.name for node, sink in self.flow.sinks().items() if not sink.shared]

    def run(
        self,
        executor: Executor | None = None,
        *,
        progress: Callable[[int, int], object] = lambda _done, _total: None,
    ) -> Generator[Replayed]:
        """Replay all recordings and yield the results in order; they do not depend on the executor.

        A recording that fails does not affect the others. `executor` and `progress` are those of `map_tasks`.

        Raises:
            FlowError: if there is an executor and an exclusive sink.
            EndpointError: if the scheduler of a cluster was lost.
        """
        if executor is not None and (exclusive := self.exclusive_sinks):
            reason = "cannot be shared by processes: replay with --jobs 1 and without --cluster"
            raise FlowError(self.flow.name, ", ".join(exclusive), reason)
        local = executor is None or isinstance(executor, LocalProcesses)
        source = self._source if local else self._source.with_files()
        paths, names = [*map(str, self.recordings)], [*map(session_of, self.existing + self.recordings)]
        if isinstance(executor, LocalProcesses) and len(paths) > 1:  # compile once, where it is logged
            with suppress(SlipflowError, OSError):  # the replay of this recording reports it
                CompiledFlow(replayed(self.flow, open_recording(self.recordings[0], log.debug)))
        with ExitStack() as stack:
            for root in self._roots:
                stack.callback(remove_partial, root, names)
            yield from map_tasks(
                partial(replay, source),
                paths,
                executor,
                progress=progress,
                lost=lambda path, reason: Replayed(path, None, error=reason),
            )

    def _exists(self, path: Path) -> bool:
        """Return True if all datasets have the session that this flow derives from a recording."""
        folders = [session_folder(root, session_of(path)) for root in self._roots]
        written = [folder for folder in folders if (folder / SESSION).exists()]
        for folder in written:
            about, recording = Session.open(folder).about, open_recording(path, log.warning)
            start = first_time(replayed(self.flow, recording), recording)
            if (about["start_ns"], about.get("declaration")) != (start, declaration(self.flow)):
                reason = "is of another recording, flow or detector: write to another dataset, or remove it"
                raise InputError(str(folder), reason)
        return bool(folders) and written == folders


def replay(source: FlowSource, path: str) -> Replayed:
    """Replay one recording; any error becomes part of the result."""
    runner, printed, error = None, StringIO(), ""
    with _LOCK:
        try:
            with ExitStack() as stack:
                if source.directory != str(Path.cwd()):
                    stack.enter_context(chdir(source.directory))
                with redirect_stdout(StringIO()):  # the command has printed it
                    flow = source.flow()
                session = session_of(Path(path))
                stack.enter_context(redirect_stdout(printed))
                scratch = {
                    node: stack.enter_context(new_session(root, session))
                    for node, root in _roots(flow).items()
                }
                recording = open_recording(Path(path), log.warning)
                flow = flow.replaced(lambda node: Dataset(scratch[node]) if node in scratch else node.part)
                runner = ReplayRunner(flow, recording, session)
                asyncio.run(runner.execute())
        except (SlipflowError, OSError) as failure:
            error = reason_of(failure)
        except Exception as failure:
            log.exception("%s", path)
            error = reason_of(failure)
    summary = None if runner is None else Summary.of(runner.run)
    return Replayed(path, summary, printed.getvalue(), error)


def recordings(paths: Iterable[Path]) -> list[Path]:
    """Return each session and trace in `paths` once; a dataset is replaced by its sessions, sorted.

    Raises:
        InputError: if a dataset has no session.
    """
    found = list[Path]()
    for path in paths:
        if (path / SESSION).exists() or not (path / SESSIONS).is_dir():
            found.append(path)  # opening reports the error if it is not a recording
        elif folders := session_folders(path):
            found += folders
        else:
            raise InputError(str(path), "has no session: give a dataset, a session's folder, or a trace")
    return [*dict.fromkeys(found)]


def session_of(recording: Path) -> str:
    """Return the name of the session that a replay or an import of a recording writes.

    >>> session_of(Path("lab/sessions/plane-050-01")), session_of(Path("data/grip 3.csv.gz"))
    ('plane-050-01', 'grip-3')
    """
    name = Path(abspath(recording)).name  # noqa: PTH100 - a link keeps its name
    stem = name if (recording / SESSION).exists() else Path(name.removesuffix(".gz")).stem
    return sub(r"[^A-Za-z0-9._-]+", "-", stem).lstrip("._-")[:128] or "recording"


def check_outputs(flow: Flow, paths: Iterable[Path]) -> None:
    """Check that a flow is valid, takes recordings, and does not record into a dataset that it replays.

    The fingertips of its sources do not matter: a replay has those of its recordings.

    Raises:
        FlowError: if the flow is wired wrongly, or has a sink for live runs only.
        InputError: if a recording is in the dataset of a sink.
    """
    validate(flow, fingertips=False)
    check_sinks_of_replay(flow)
    written = {*_roots(flow).values()}
    for path in paths:
        if written & set(path.resolve().parents):
            raise InputError(str(path), "is in the dataset that the flow records into: choose another folder")


def open_recording(path: Path, warn: Callable[[str], object]) -> Recording:
    """Open a session or a trace in a file; report warnings about a trace with `warn`.

    Raises:
        InputError: if it is neither, or damaged.
    """
    from connectors.files.trace import Trace

    if not path.exists():
        raise InputError(str(path), "there is no such file or folder")
    if not path.is_file():
        return Session.open(path)

    trace = Trace(path)
    try:
        warnings = trace.part.warnings
    except InputError as error:
        reason = f"{error.reason} (convert it with slipflow import --map, then replay the result)"
        raise InputError(error.where, reason) from error
    for each in warnings:
        warn(f"warning: {path}: {each} (slipflow import --map states units)")
    return trace


def _roots(flow: Flow) -> dict[Node, Path]:
    """Return the folders of the datasets that a flow records into."""
    return {node: Path(sink.destination) for node, sink in flow.sinks().items() if isinstance(sink, Dataset)}


def _check_names(paths: Sequence[Path]) -> None:
    """Require that each recording has a name of its own, which becomes that of its session."""
    names = dict[str, Path]()
    for path in paths:
        if (first := names.setdefault(session_of(path), path)) is not path:
            raise InputError(str(path), f"has the same name as {first}: replay it into another dataset")

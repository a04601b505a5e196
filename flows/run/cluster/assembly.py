"""Assembly of a session from stored results: a replay that reads results instead of running operators.

The code that cuts streams and writes sinks is that of a single-process replay, so the session's files are
byte-identical.
"""

import asyncio
import os
from collections.abc import Mapping
from pathlib import Path
from shutil import rmtree
from typing import Any, Final
from uuid import uuid4

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Entry, Stage
from flows.graph.node import Node, Part
from flows.run.cluster.work_units import RecordingEnd, ShareResult
from flows.run.cluster.worker import SliceResult, read_results
from flows.run.replay_runner import ReplayRunner
from operators.batch import Batch
from operators.errors import EndpointError, InputError, os_error_reason
from storage import Dataset, Session
from storage.description import describe_dataset
from storage.files import make_folder, sync
from storage.layout import MANIFEST, SESSIONS, session_folder

JOBS: Final = ".jobs"  # folder in a dataset


class StoredResults(CompiledFlow):
    """Compiled flow that returns stored results instead of running its operators.

    Args:
        flow: Flow over the recording.
        folder: Folder of the results, with a folder per share.
        end: End of the recording.
    """

    def __init__(self, flow: Flow, folder: Path, end: RecordingEnd) -> None:
        super().__init__(flow)
        self._index = {node: number for number, node in enumerate(flow.nodes)}
        self._shares = [read_results(folder / str(share), end.units) for share in range(len(end.shares))]
        self.slices = 0  # pushed so far

    def outputs(self, batches: Mapping[Entry, Batch]) -> list[tuple[Stage, Batch]]:
        """Return the next slice's batches and results."""
        self.slices += 1
        return [(self.stage(entry), batch) for entry, batch in batches.items()] + self.last_outputs()

    def last_outputs(self) -> list[tuple[Stage, Batch]]:
        """Return the results of the next slice; after the last one, those at the end of all streams."""
        results = SliceResult()
        for share in self._shares:
            results |= next(share, SliceResult())
        found = [
            (stage, results.get((self._index[stage.node], stage.finger))) for stage in self.operator_stages
        ]
        return [(stage, batch) for stage, batch in found if batch is not None]


def assemble(flow: Flow, datasets: Mapping[str, str], job: str, results: Path, share: ShareResult) -> None:
    """Write a session into each dataset of a flow from stored results.

    A session appears in a dataset as a whole. If it is already in the dataset, nothing changes.

    Args:
        flow: Flow that the job runs.
        datasets: Folders of its datasets, by the names of the sinks.
        job: Name of the job.
        results: Folder of the session's results, with a folder per share.
        share: Result of any share, which names the recording and its end.

    Raises:
        InputError: if the recording or a result cannot be read, or another session has that name.
        EndpointError: if a dataset cannot be written to.
    """
    assert share.end, "a session with a failed share is not assembled"
    end, attempt, compiled = share.end, uuid4().hex, list[StoredResults]()
    scratch = {name: Path(root) / JOBS / job / attempt for name, root in datasets.items()}

    def to_scratch(node: Node) -> Part:
        part: Any = node.part
        return part.with_path(scratch[node.name]) if isinstance(part, Dataset) else part

    def compile_flow(replayed: Flow) -> CompiledFlow:
        compiled.append(StoredResults(replayed, results, end))
        return compiled[0]

    try:
        recording = Session.open(share.folder)
        runner = ReplayRunner(flow.replaced(to_scratch), recording, share.session, compile_flow=compile_flow)
        asyncio.run(runner.execute())
        if compiled[0].slices != end.slices:
            raise InputError(share.folder, "has changed since the job began")
        for name, root in datasets.items():
            _commit(session_folder(scratch[name], share.session), Path(root), share.session)
    finally:
        for folder in scratch.values():
            rmtree(folder, ignore_errors=True)


def _commit(complete: Path, root: Path, session: str) -> None:
    """Move a complete session into a dataset, unless the dataset has it already."""
    target = session_folder(root, session)
    try:
        describe_dataset(root)
        make_folder(root / SESSIONS)
        if target.exists():
            if (target / MANIFEST).read_bytes() != (complete / MANIFEST).read_bytes():
                raise InputError(str(target), "another session has this name: write to another dataset")
            return
        os.rename(complete, target)  # noqa: PTH104 - unlike Path.replace, never replaces a folder with files
        sync(root / SESSIONS)
    except OSError as error:
        raise EndpointError(str(root), f"cannot be written: {os_error_reason(error)}") from error

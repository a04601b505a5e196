"""Writing of a session: a replay that takes the events from the results of work units.

The code that cuts streams and writes sinks is that of a single-process replay, so the session's files are
byte-identical.
"""

import asyncio
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any, Final, cast
from uuid import uuid4

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.node import Node, Part
from flows.run.cluster.work_units import SliceResult, UnitResult
from flows.run.cluster.worker import event_nodes, result_nodes, with_inputs
from flows.run.replay_runner import ReplayRunner
from operators.batch import Batch
from operators.errors import EndpointError, InputError, os_error_reason
from storage import Dataset, Session
from storage.description import describe_dataset
from storage.files import make_folder, sync
from storage.layout import MANIFEST, SESSIONS, session_folder

JOBS: Final = ".jobs"  # folder in a dataset


class StoredEvents(CompiledFlow):
    """Compiled flow that takes events from the results of work units instead of running their operators.

    Args:
        flow: Flow over the recording.
        shares: Results of each share, slice by slice.
    """

    def __init__(self, flow: Flow, shares: Sequence[Iterator[SliceResult]]) -> None:
        events = event_nodes(flow)
        super().__init__(flow, operators=with_inputs(result_nodes(flow) - events))
        self._nodes, self._shares = flow.nodes, shares
        self.slices = 0  # pushed so far

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        """Return the next slice's batches for the sinks; a sink gets each type from one operator only."""
        self.slices += 1
        return super().push(batches) + self._events()

    def flush(self) -> list[Delivery]:
        """Return the batches at the end of all streams."""
        return super().flush() + self._events()

    def _events(self) -> list[Delivery]:
        """Return the events of the next slice, in the order of a compiled flow."""
        events = SliceResult()
        for share in self._shares:
            events |= next(share, SliceResult())
        return [(self._nodes[index], events[index, finger]) for index, finger in sorted(events)]


def assemble(
    flow: Flow,
    datasets: Mapping[str, str],
    job: str,
    last: UnitResult,
    shares: Sequence[Iterator[SliceResult]],
) -> None:
    """Write a session into each dataset of a flow.

    A session appears in a dataset as a whole. If it is already in the dataset, nothing changes.

    Args:
        flow: Flow that the job runs.
        datasets: Folders of its datasets, by the names of the sinks.
        job: Name of the job.
        last: Last result of any share, which names the recording and its end.
        shares: Results of each share, slice by slice.

    Raises:
        InputError: if the recording cannot be read, or another session has that name.
        EndpointError: if a dataset cannot be written to.
    """
    unit, end = last.unit, last.unit.end
    assert end, "a session with a failed unit is not written"
    attempt = uuid4().hex
    scratch = {name: Path(root) / JOBS / job / attempt for name, root in datasets.items()}

    def to_scratch(node: Node) -> Part:
        part: Any = node.part
        return part.with_path(scratch[node.name]) if isinstance(part, Dataset) else part

    try:
        stored = partial(StoredEvents, shares=shares)
        recording = Session.open(unit.folder)
        runner = ReplayRunner(flow.replaced(to_scratch), recording, unit.session, compile_flow=stored)
        asyncio.run(runner.execute())
        if cast("StoredEvents", runner.compiled).slices != end.slices:
            raise InputError(unit.folder, "has changed since the job began")
        for name, root in datasets.items():
            _commit(session_folder(scratch[name], unit.session), Path(root), unit.session)
    finally:
        for each in scratch.values():
            rmtree(each, ignore_errors=True)


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

"""Making a session of what the workers staged: a replay whose operators' work is done already.

The recording is cut and the sinks are written to as in one process, by the same code, so the session's files
are the same, byte for byte.
"""

import asyncio
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree
from typing import Any, Final, TypeAlias, cast
from uuid import uuid4

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.node import Node, Part
from flows.run.cluster.cluster_segment import tapped
from flows.run.cluster.staging import Given, staged_in
from flows.run.cluster.work_units import Done, End
from flows.run.replay_runner import ReplayRunner
from operators.batch import Batch
from operators.errors import EndpointError, InputError, os_error_reason
from storage import Dataset, Session
from storage.description import describe_dataset
from storage.files import make_folder, sync
from storage.layout import MANIFEST, SESSIONS, session_folder

JOBS: Final = ".jobs"  # a folder of a dataset
_Place: TypeAlias = tuple[int, int]  # an operator's among the flow's nodes, and the fingertip


@dataclass
class _Staged:
    """What the claims of one share came to, slice by slice."""

    claims: Iterator[Given]
    # by slice
    _rest: dict[int, dict[_Place, Batch]] = field(default_factory=dict[int, dict[_Place, Batch]], init=False)

    def take(self, number: int) -> dict[_Place, Batch]:
        """What operators gave for a slice; slices are asked for in order."""
        while max(self._rest, default=-1) < number:
            more = next(self.claims, None)
            if more is None:
                break
            for (each, operator, finger), batch in more.items():
                self._rest.setdefault(each, {})[operator, finger] = batch
        return self._rest.pop(number, {})


class Assembled(CompiledFlow):
    """A plan of a flow that gives what was staged, instead of working it out.

    Args:
        flow: The flow, over the recording.
        folder: Where it is staged, by share.
        end: What is staged of each share.
    """

    def __init__(self, flow: Flow, folder: Path, end: End) -> None:
        super().__init__(flow)
        self._nodes = {node: place for place, node in enumerate(flow.nodes)}
        kinds = {self._nodes[node]: cast("type[Batch]", node.gives) for node in tapped(flow)}
        self._staged = [
            _Staged(staged_in(folder / str(share), end.claims, kinds)) for share in range(len(end.shares))
        ]
        self.slices = 0  # that were given

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        """What the sinks are to take of the next slice."""
        deliveries = [
            (sink, batch)
            for entry, batch in batches.items()
            for sink in self._stages[self._stage_of[entry]].sinks
        ]
        self.slices += 1
        return deliveries + self._given(self.slices - 1)

    def flush(self) -> list[Delivery]:
        """What the sinks are to take at the end of all streams."""
        return self._given(self.slices)

    def _given(self, number: int) -> list[Delivery]:
        given = dict[_Place, Batch]()
        for share in self._staged:
            given |= share.take(number)
        deliveries = list[Delivery]()
        for stage in self._operator_stages:
            batch = given.get((self._nodes[stage.node], stage.finger))
            if batch is not None:
                deliveries += [(sink, batch) for sink in stage.sinks]
        return deliveries


def assemble(flow: Flow, places: Mapping[str, str], job: str, staged: Path, done: Done) -> None:
    """Write a session into each dataset of a flow from what was staged, and remove that.

    A session appears in a dataset whole. If this was done before, nothing is changed.

    Args:
        flow: The flow.
        places: The folders of its datasets, by the names of the sinks.
        job: The job's name.
        staged: Where the session's turn is staged, by share.
        done: The session, and in which shares it was worked on.

    Raises:
        InputError: if the recording or what was staged cannot be read, or there is another session of that
            name.
        EndpointError: if a dataset cannot be written to.
    """
    assert done.end, "only what came to its end is assembled"
    end, attempt, plans = done.end, uuid4().hex, list[Assembled]()
    scratch = {name: Path(place) / JOBS / job / attempt for name, place in places.items()}

    def elsewhere(node: Node) -> Part:
        part: Any = node.part
        return part.moved(scratch[node.name]) if isinstance(part, Dataset) else part

    def compile_flow(replayed: Flow) -> CompiledFlow:
        plans.append(Assembled(replayed, staged, end))
        return plans[0]

    try:
        recording = Session.open(done.folder)
        runner = ReplayRunner(flow.replaced(elsewhere), recording, done.session, compile_flow=compile_flow)
        asyncio.run(runner.execute())
        if plans[0].slices != end.slices:
            raise InputError(done.folder, "has changed since the job began")
        for name, place in places.items():
            _commit(session_folder(scratch[name], done.session), Path(place), done.session)
    finally:
        for folder in scratch.values():
            rmtree(folder, ignore_errors=True)


def _commit(whole: Path, root: Path, session: str) -> None:
    """Give a whole session its place in a dataset, unless it is there already."""
    target = session_folder(root, session)
    try:
        describe_dataset(root)
        make_folder(root / SESSIONS)
        if target.exists():
            if (target / MANIFEST).read_bytes() != (whole / MANIFEST).read_bytes():
                raise InputError(str(target), "is another session of that name; give another dataset")
            return
        os.rename(whole, target)  # noqa: PTH104 - as of folders, never onto one that holds anything
        sync(root / SESSIONS)
    except OSError as error:
        raise EndpointError(str(root), f"cannot be written: {os_error_reason(error)}") from error

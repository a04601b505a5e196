"""Splitting of a recording into work units, cut at the same times as a replay in one process."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Entry
from flows.run.cluster.work_units import RecordingEnd, RowRange, WorkUnit
from flows.run.cluster.worker import checked_type, event_nodes, result_nodes, with_inputs
from flows.run.replay_runner import in_slices, replayed
from operators.batch import EVERY, Batch, Times, column
from operators.errors import FlowError, InputError
from operators.fingertip import Fingertip
from operators.ports import Description, SomeBatch
from storage import Dataset, Session
from storage.layout import TABLE_OF, inside


class _RowTimes(Batch):
    """Times of rows and their positions in the files: enough to split a recording."""

    part: Times = column(np.int64)  # (n,) number of the file in its table
    row: Times = column(np.int64)  # (n,) position among the file's rows of the fingertip


class _IncompleteError(Exception):
    """End of the rows of a stream that may still grow."""


@dataclass
class Splitter:
    """Splitter of one recording, which may still grow, into work units.

    Args:
        flow: Flow to run.
        folder: Folder of the session, on storage that all machines of the cluster share.
        rows: Largest batch of a stream; the writer of the session must use the same value.
        slices: Slices per unit.
        shares: Largest number of shares that the fingertips are split into.
        number: Number of the recording; recordings and shares are assigned to the workers in turn.
    """

    flow: Flow
    folder: Path
    rows: int = 1000
    slices: int = 16
    shares: int = 8
    number: int = 0
    ended: bool = field(default=False, init=False)  # the last units were returned
    _times: dict[str, dict[int, _RowTimes]] = field(
        default_factory=dict[str, dict[int, _RowTimes]], init=False
    )
    _generation: int = field(default=0, init=False)
    _done: int = field(default=0, init=False)  # units of each share in this generation
    _sources: Mapping[str, tuple[int, ...]] = field(default_factory=dict[str, tuple[int, ...]], init=False)

    def units(self, *, growing: bool = False) -> list[WorkUnit]:
        """Return the units that are new since the last call; units of one time span follow each other.

        If a new fingertip appears in a growing recording, it is split again from its start, in a new
        generation.

        Args:
            growing: Wait for the rows that an open session may still get.

        Raises:
            InputError: if the recording cannot be read, or lacks a stream that the flow needs.
        """
        if self.ended:
            return []
        session = Session.open(self.folder)
        recording = _RowTimesRecording(session, self._times)
        closed = not growing or "end_ns" in session.about
        try:
            flow = replayed(self.flow, recording, paced=False)
        except InputError:
            if closed:
                raise
            return []  # a stream has no part yet
        sources = {node.name: node.fingers for node in flow.sources()}
        if self._done and sources != self._sources:
            self._generation, self._done = self._generation + 1, 0
        self._sources = sources
        slices = list(self._cut(recording, flow, closed=closed))
        if closed and not slices:
            raise InputError(str(self.folder), "is empty: it has no rows to replay")
        self.ended = closed
        return self._new_units(session, flow, slices, closed=closed)

    def _cut(
        self, recording: "_RowTimesRecording", flow: Flow, *, closed: bool
    ) -> Iterator[dict[Entry, _RowTimes]]:
        streams: dict[Entry, Iterator[Batch]] = {}
        for node, finger in CompiledFlow(flow).entries:
            stream = recording.read(cast("type[Batch]", node.gives), finger, self.rows)
            streams[node, finger] = stream if closed else _incomplete(stream)
        try:
            yield from cast("Iterator[dict[Entry, _RowTimes]]", in_slices(streams))
        except _IncompleteError:
            return

    def _new_units(
        self, session: Session, flow: Flow, slices: list[dict[Entry, _RowTimes]], *, closed: bool
    ) -> list[WorkUnit]:
        files = {
            node.name: list(session.files(cast("type[Batch]", node.gives)).items()) for node in flow.sources()
        }
        needed, shares = with_inputs(event_nodes(flow)), split_fingers(flow, self.shares)
        last = max(-(-len(slices) // self.slices) - 1, 0) if closed else len(slices) // self.slices - 1
        units = list[WorkUnit]()
        for number in range(self._done, last + 1):
            first = number * self.slices
            group = slices[first : first + self.slices]
            end = RecordingEnd(len(slices), last + 1, len(shares)) if closed and number == last else None
            for share, fingers in enumerate(shares):
                own = tuple(
                    tuple(
                        _row_range(entry, times, files)
                        for entry, times in each.items()
                        if entry[0] in needed and entry[1] in (*fingers, EVERY)
                    )
                    for each in group
                )
                about = (session.name, str(self.folder), self.number, self._generation)
                units.append(WorkUnit(*about, share, fingers, number, self._sources, own, end))
        self._done = max(self._done, last + 1)
        return units


def check_flow(flow: Flow) -> None:
    """Require that a flow can run on a cluster.

    Raises:
        FlowError: if a sink is not a dataset, or no dataset takes the rows of an operator.
    """
    for node in flow.sinks():
        if not isinstance(node.part, Dataset):
            reason = "a cluster writes datasets only: remove this sink, or set the parameter that adds it"
            raise FlowError(flow.name, node.name, reason)
    if not result_nodes(flow):
        raise FlowError(
            flow.name, "datasets", "none takes the rows of an operator: add a dataset after an operator"
        )


def split_fingers(flow: Flow, most: int) -> tuple[tuple[int, ...], ...]:
    """Split the fingertips that have events into at most `most` shares; EVERY counts as one.

    Each share reads whole parts, so few large shares cost less than many small ones. A flow without events
    has one share without fingertips.
    """
    fingers = sorted({finger for node in event_nodes(flow) for finger in node.fingers})
    count = max(min(most, len(fingers)), 1)
    return tuple(tuple(fingers[share::count]) for share in range(count))


def _row_range(entry: Entry, times: _RowTimes, files: Mapping[str, list[tuple[str, str]]]) -> RowRange:
    name = entry[0].name
    path, sha256 = files[name][times.part.item(0)]
    return RowRange(name, entry[1], path, sha256, times.row.item(0), times.row.item(-1) + 1)


def _incomplete(stream: Iterator[Batch]) -> Iterator[Batch]:
    yield from stream
    raise _IncompleteError


@dataclass
class _RowTimesRecording:
    """Session as a recording that reads times only."""

    session: Session
    times: dict[str, dict[int, _RowTimes]]  # by file; kept between calls

    @property
    def name(self) -> str:
        return str(self.session.folder)

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        return tuple(sorted({finger for part in self._parts(kind) for finger in part}))

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        for part in self._parts(kind):
            batch = part.get(finger)
            for start in range(0, 0 if batch is None else len(batch), rows):
                yield cast("SomeBatch", cast("_RowTimes", batch)[start : start + rows])

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        return self.session.fingertip(kind)

    def describe(self) -> Description:
        return self.session.about

    def _parts(self, kind: type[Batch]) -> Iterator[dict[int, _RowTimes]]:
        for number, (path, sha256) in enumerate(self.session.files(kind).items()):
            if path not in self.times:
                self.times[path] = _read_row_times(self.session.folder, kind, path, sha256, number)
            yield self.times[path]


def _read_row_times(
    folder: Path, kind: type[Batch], path: str, sha256: str, part: int
) -> dict[int, _RowTimes]:
    """Return the times of a file's rows by fingertip; empty if they are not of type `kind`."""
    from storage import parts, schema  # noqa: PLC0415 - import pyarrow

    table = TABLE_OF[kind]
    rows = parts.read_part(inside(folder, folder / path), schema.time_schema(table), sha256)
    if not issubclass(checked_type(folder / path, schema.batch_type(rows), table.kind), kind):
        return {}
    return {
        finger: _RowTimes(time, np.full(len(time), part), np.arange(len(time)), finger=finger)
        for finger, time in schema.times(table, rows).items()
    }

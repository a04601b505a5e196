"""Processing of work units: a pure function of state and unit, independent of Flink.

Units may arrive repeatedly and in any order. They are numbered, and each is processed once, in order. A
result's file name follows from its unit, and its content from the recording and the flow: a unit that is
processed again, after a failure or by another worker, writes the same rows to the same file.
"""

import os
import pickle
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias, cast
from uuid import uuid4
from zlib import crc32

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Entry, Stage
from flows.graph.node import Node, Part
from flows.run.cluster.work_units import ShareResult, Slice, WorkUnit
from operators.batch import Batch
from operators.errors import EndpointError, InputError, SlipflowError, os_error_reason
from operators.ports import Clock, Source
from storage import files
from storage.layout import TABLE_OF, inside

_CACHED_PARTS: Final = 16  # parts kept in memory, because units of many fingertips name the same ones
_CRC: Final = 4  # bytes before the pickle of a result

SliceResult: TypeAlias = dict[
    tuple[int, int], Batch
]  # by the operator's index in the flow, and the fingertip


class UnitSource(Source[Batch]):
    """Placeholder for a source; the worker pushes the rows that the work units name.

    Args:
        kind: Type of the batches.
        fingers: Fingertips of the source.
    """

    def __init__(self, kind: type[Batch], fingers: tuple[int, ...]) -> None:
        self._kind, self._fingers = kind, fingers

    @property
    def kind(self) -> type[Batch]:
        """Type of the batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips of the source."""
        return self._fingers

    def batches(self, clock: Clock) -> AsyncIterator[Batch]:
        """Raise an error: no runner reads this source."""
        raise NotImplementedError


@dataclass
class _State:
    """State of a share between units."""

    next: int = 0  # number of the next unit; -1: none
    waiting: dict[int, WorkUnit] = field(default_factory=dict[int, WorkUnit])  # units that arrived early
    operators: bytes = b""  # snapshot of the operators; empty before the first unit


class Worker:
    """Processor of work units, one at a time, that stores their results.

    Args:
        flow: Flow that the units belong to.
        results: Folder for the results.
    """

    def __init__(self, flow: Flow, results: Path) -> None:
        self._flow, self._results = flow, results
        self._read_part = lru_cache(_CACHED_PARTS)(read_part)

    def process(self, state: bytes | None, unit: WorkUnit) -> tuple[bytes, ShareResult | None]:
        """Process a unit; return the new state, and the share's result if this was its last unit.

        An error that would occur again ends the share and becomes its result.

        Args:
            state: State after the previous unit; None: this is the first.
            unit: Unit with any number.

        Raises:
            EndpointError: if the result cannot be stored; the old state remains valid.
        """
        share = _State() if state is None else cast("_State", pickle.loads(state))  # noqa: S301 - our own
        result = None
        if share.next >= 0 and unit.number >= share.next:
            try:
                result = self._advance(share, unit)
            except EndpointError:
                raise
            except SlipflowError as error:
                result = ShareResult.of(unit, str(error))
            if result:
                share = _State(next=-1)
        return pickle.dumps(share, pickle.HIGHEST_PROTOCOL), result

    def _advance(self, share: _State, newest: WorkUnit) -> ShareResult | None:
        """Process `newest` and the waiting units after it, or store it until its turn."""
        if newest.number > share.next:
            share.waiting[newest.number] = newest
            return None
        flow = self._flow.replaced(lambda node: _placeholder(node, newest.sources))
        compiled = CompiledFlow(flow, only=newest.fingers)
        if share.operators:
            compiled.restore(share.operators)
        index = {node: number for number, node in enumerate(flow.nodes)}
        sources = {node.name: node for node in flow.sources()}

        def result_of(outputs: list[tuple[Stage, Batch]]) -> SliceResult:
            """Return the results of the share's own fingertips; rows of EVERY belong to one share."""
            return {
                (index[stage.node], stage.finger): batch
                for stage, batch in outputs
                if stage.sinks and stage.operator is not None and stage.finger in newest.fingers
            }

        due: WorkUnit | None = newest
        while unit := due:
            result = [result_of(compiled.outputs(self._rows(unit, each, sources))) for each in unit.slices]
            if unit.end:
                result.append(result_of(compiled.last_outputs()))
            _write_result(self._results / unit.key / result_file(unit.number), result)
            if unit.end:
                return ShareResult.of(unit)
            share.next += 1
            due = share.waiting.pop(share.next, None)
        share.operators = compiled.snapshot()
        return None

    def _rows(self, unit: WorkUnit, rows: Slice, sources: Mapping[str, Node]) -> dict[Entry, Batch]:
        found = dict[Entry, Batch]()
        for each in rows:
            node = sources[each.source]
            kind: Any = node.gives
            part = self._read_part(Path(unit.folder), kind, each.path, each.sha256)
            found[node, each.finger] = part[each.finger][each.start : each.stop]
        return found


def _placeholder(node: Node, fingers: Mapping[str, tuple[int, ...]]) -> Part:
    kind = cast("type[Batch]", node.gives)
    return UnitSource(kind, fingers[node.name]) if isinstance(node.part, Source) else node.part


def read_part(folder: Path, kind: type[Batch], path: str, sha256: str | None) -> Mapping[int, Batch]:
    """Return the rows of a part of a session by fingertip.

    Raises:
        InputError: if the file is missing, damaged, has another SHA-256 or rows of another type.
    """
    from storage import parts, schema  # noqa: PLC0415 - import pyarrow

    table = TABLE_OF[kind]
    rows = parts.read_part(inside(folder, folder / path), schema.schema(table), sha256)
    return schema.from_arrow(table, checked_type(folder / path, schema.batch_type(rows), table.kind), rows)


def checked_type(path: Path, stored: type[Batch] | None, kind: type[Batch]) -> type[Batch]:
    """Return the stored type of a part's rows.

    Raises:
        InputError: if it does not fit the table of `kind`.
    """
    if stored is None or not issubclass(stored, kind):
        raise InputError(str(path), 'its metadata "batch" is missing or does not fit its table')
    return stored


def _write_result(path: Path, result: list[SliceResult]) -> None:
    """Write a result atomically and durably; two workers may write the same one at once."""
    data = pickle.dumps(result, pickle.HIGHEST_PROTOCOL)
    scratch = path.with_name(f"{path.name}.{uuid4().hex}{files.SCRATCH}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch.open("xb") as file:
            file.write(crc32(data).to_bytes(_CRC) + data)
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(path)
        files.sync(path.parent)
    except OSError as error:
        with suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from error


def read_results(folder: Path, units: int) -> Iterator[SliceResult]:
    """Yield the results of a share's `units` units, slice by slice.

    Raises:
        InputError: if a file is missing or damaged.
    """
    for number in range(units):
        path = folder / result_file(number)
        data = files.read(path)
        if crc32(data[_CRC:]).to_bytes(_CRC) != data[:_CRC]:
            raise InputError(str(path), "is damaged")
        yield from cast("list[SliceResult]", pickle.loads(data[_CRC:]))  # noqa: S301 - our own


def result_file(number: int) -> str:
    """Return the file name of a unit's result.

    >>> result_file(7)
    '000007.result'
    """
    return f"{number:06d}.result"

"""Processing of work units: a pure function of state and unit, independent of Flink.

Units may arrive repeatedly and in any order. They are numbered, and each is processed once, in order.

A unit gives events only, which are few. Rows of the other tables, one per recorded sample, are derived when
the session is written: deriving them again costs less than to store and read them.
"""

import pickle
from collections.abc import AsyncIterator, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, cast

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.node import Node, Part
from flows.run.cluster.work_units import Slice, SliceResult, UnitResult, WorkUnit
from operators.batch import Batch
from operators.errors import EndpointError, InputError, SlipflowError
from operators.ports import Clock, Source
from storage.layout import TABLE_OF, inside

_CACHED_PARTS: Final = 16  # parts kept in memory, because consecutive units name the same ones


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
    """Processor of work units, one at a time.

    Args:
        flow: Flow that the units belong to.
    """

    def __init__(self, flow: Flow) -> None:
        self._flow = flow
        self._read_part = lru_cache(_CACHED_PARTS)(read_part)

    def process(self, state: bytes | None, unit: WorkUnit) -> tuple[bytes, list[UnitResult]]:
        """Process a unit; return the new state, and the results of the unit and of those that waited for it.

        An error that would occur again ends the share and becomes its result.

        Args:
            state: State after the previous unit; None: this is the first.
            unit: Unit with any number.

        Raises:
            EndpointError: if there is not enough memory; the old state remains valid.
        """
        share = _State() if state is None else cast("_State", pickle.loads(state))  # noqa: S301 - our own
        results = list[UnitResult]()
        if share.next >= 0 and unit.number > share.next:
            share.waiting[unit.number] = unit
        elif unit.number == share.next:
            try:
                results = self._advance(share, unit)
            except EndpointError:
                raise
            except SlipflowError as error:
                results = [UnitResult.of(unit, error=str(error))]
            if results[-1].unit.end or results[-1].error:
                share = _State(next=-1)
        return pickle.dumps(share, pickle.HIGHEST_PROTOCOL), results

    def _advance(self, share: _State, newest: WorkUnit) -> list[UnitResult]:
        """Process `newest` and the waiting units after it."""
        flow = self._flow.replaced(lambda node: _placeholder(node, newest.sources))
        events = event_nodes(flow)
        compiled = CompiledFlow(flow, newest.fingers, with_inputs(events))
        if share.operators:
            compiled.restore(share.operators)
        index = {node: number for number, node in enumerate(flow.nodes)}
        sources = {node.name: node for node in flow.sources()}

        def result_of(deliveries: list[Delivery]) -> SliceResult:
            """Return the events of the share's own fingertips; rows of EVERY belong to one share."""
            return {
                (index[node], batch.finger): batch
                for node, batch in deliveries
                if node in events and batch.finger in newest.fingers
            }

        results, due = list[UnitResult](), cast("WorkUnit | None", newest)
        while unit := due:
            slices = [result_of(compiled.push(self._rows(unit, each, sources))) for each in unit.slices]
            if unit.end:
                slices.append(result_of(compiled.flush()))
            results.append(UnitResult.of(unit, tuple(slices)))
            share.next += 1
            due = share.waiting.pop(share.next, None)
        share.operators = compiled.snapshot()
        return results

    def _rows(self, unit: WorkUnit, rows: Slice, sources: Mapping[str, Node]) -> dict[Entry, Batch]:
        found = dict[Entry, Batch]()
        for each in rows:
            node = sources[each.source]
            kind: Any = node.gives
            part = self._read_part(Path(unit.folder), kind, each.path, each.sha256)
            found[node, each.finger] = part[each.finger][each.start : each.stop]
        return found


def result_nodes(flow: Flow) -> set[Node]:
    """Return the operators whose rows go to sinks."""
    return {each for sink in flow.sinks() for each in sink.inputs if not isinstance(each.part, Source)}


def event_nodes(flow: Flow) -> set[Node]:
    """Return the operators that work units run for: they give events, and no other result needs them."""
    results = result_nodes(flow)
    return results - with_inputs(filter(_is_parted, results))


def _is_parted(node: Node) -> bool:
    table = TABLE_OF.get(cast("type[Batch]", node.gives))
    return table is None or table.parted


def with_inputs(nodes: Iterable[Node]) -> set[Node]:
    """Return nodes and all that they read from, directly or not."""
    found, rest = set[Node](), list(nodes)
    while rest:
        node = rest.pop()
        found.add(node)
        rest += node.inputs
    return found


def _placeholder(node: Node, fingers: Mapping[str, tuple[int, ...]]) -> Part:
    kind = cast("type[Batch]", node.gives)
    return UnitSource(kind, fingers[node.name]) if isinstance(node.part, Source) else node.part


def read_part(folder: Path, kind: type[Batch], path: str, sha256: str) -> Mapping[int, Batch]:
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

"""Processing of work units: a pure function of state and unit, independent of Flink.

Units may arrive repeatedly and in any order. They are numbered, and each is processed once, in order.
"""

import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.node import Node
from flows.run.cluster.cluster_segment import ResultSink, segment
from flows.run.cluster.part_files import PartReader
from flows.run.cluster.unit_results import UnitResult, result_file, write_result
from flows.run.cluster.work_units import ShareResult, Slice, WorkUnit
from operators.batch import Batch
from operators.errors import EndpointError, SlipflowError


@dataclass
class _State:
    """State of a share between units."""

    next: int = 0  # number of the next unit; -1: none
    waiting: dict[int, str] = field(default_factory=dict[int, str])  # units that arrived early, as lines
    operators: bytes = b""  # snapshot of the operators; empty before the first unit


class Worker:
    """Processor of work units, one at a time, that stores their results.

    Args:
        flow: Flow that the units belong to.
        results: Folder for the results.
    """

    def __init__(self, flow: Flow, results: Path) -> None:
        self._flow, self._results = flow, results
        self._reader = PartReader()

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
            share.waiting[newest.number] = newest.to_line()
            return None
        flow = segment(self._flow, newest.sources)
        compiled = CompiledFlow(flow, only=newest.fingers)
        if share.operators:
            compiled.restore(share.operators)
        entries = {node.name: node for node in flow.sources()}
        due: WorkUnit | None = newest
        while unit := due:
            result: UnitResult = {}
            for each in unit.slices:
                batches: dict[Entry, Batch] = {
                    (entries[rows.source], rows.finger): batch
                    for rows, batch in zip(each.rows, self._read(unit, each, entries), strict=True)
                }
                _collect(result, each.number, compiled.push(batches), unit.fingers)
            if unit.end:
                _collect(result, unit.end.slices, compiled.flush(), unit.fingers)
            write_result(self._results / unit.key / result_file(unit.number), result)
            if unit.end:
                return ShareResult.of(unit)
            share.next += 1
            line = share.waiting.pop(share.next, None)
            due = WorkUnit.from_line(line) if line else None
        share.operators = compiled.snapshot()
        return None

    def _read(self, unit: WorkUnit, each: Slice, entries: dict[str, Node]) -> list[Batch]:
        batches = list[Batch]()
        for rows in each.rows:
            kind = cast("type[Batch]", entries[rows.source].gives)
            part = self._reader.read(Path(unit.folder), kind, rows.path, rows.sha256)
            batches.append(part[rows.finger][rows.start : rows.stop])
        return batches


def _collect(result: UnitResult, number: int, deliveries: list[Delivery], fingers: tuple[int, ...]) -> None:
    """Add the batches of the share's own fingertips; rows of every fingertip (EVERY) belong to one share."""
    for sink, batch in deliveries:
        if batch.finger in fingers:
            result[number, cast("ResultSink", sink.part).operator, batch.finger] = batch

"""Execution of a flow over a recording: the same graph as in a live run, at full speed."""

import asyncio
import logging
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import chain, islice
from typing import Any, cast

import numpy as np

from connectors.replay import Replay
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.drawing import streams
from flows.graph.node import FlowPart, Node, check_extras, consumers
from flows.run.clocks import EventClock
from flows.run.failures import contained, reason_of
from flows.run.source_reader import count_rows
from operators.batch import ANNOTATIONS, Batch
from operators.errors import FlowError, InputError
from operators.operator import Join, LateRowFilter, Operator
from operators.ports import Clock, Recording, Run, Sink, SinkStatus, Source, SourceStatus
from operators.score import Score
from storage.description import checksum

log = logging.getLogger("slipflow")


def replayed(flow: Flow, recording: Recording) -> Flow:
    """Return a copy of a flow that reads its sources from a recording.

    A source reads the recorded fingertips that it declares, or all if no other source has its type.

    Raises:
        InputError: if the recording lacks the stream of a source.
    """
    kinds = [source.kind for source in flow.sources().values()]

    def recorded(node: Node) -> FlowPart:
        part = node.part
        if not isinstance(part, Source):
            return part
        kind = cast("type[Batch]", part.kind)
        fingers = recording.fingers(kind)
        if kinds.count(kind) > 1:
            fingers = tuple(finger for finger in fingers if finger in part.fingers)
        if not fingers and kind not in ANNOTATIONS:
            reason = f"has no {kind.__name__.lower()} stream, which source {node.name!r} needs"
            raise InputError(recording.name, f"{reason} (flow {flow.name!r})")
        return Replay(recording, kind, fingers)

    return flow.replaced(recorded)


def check_sinks_of_replay(flow: Flow) -> None:
    """Check that a flow can be replayed.

    Raises:
        FlowError: naming the sinks that are for live runs only.
    """
    if found := [node.name for node, sink in flow.sinks().items() if sink.live_only]:
        reason = "is for live runs: remove it to replay a recording"
        raise FlowError(flow.name, ", ".join(found), reason)


def declaration(flow: Flow) -> list[str]:
    """Return the definition of each stream, then checksums of each model, all parameters and the code.

    A definition only names a model, whose weights another training may have replaced, and shortens arrays.
    """
    lines, parameters = streams(flow.nodes), list[str]()
    for part in (node.part for node in flow.nodes if isinstance(node.part, Operator | Join)):
        sums = {f.name: checksum(getattr(part, f.name)) for f in fields(part) if f.init}
        parameters += [f"{name} {each}" for name, each in sums.items()]
        if isinstance(part, Score):
            name = getattr(part.detector, "model", "") or getattr(part.detector, "name", "detector")
            lines.append(f"{name} = {sums['detector']}")
    lines.append(f"parameters = {checksum(parameters)}")
    return [*lines, f"code = sha256 {flow.code}"] if flow.code else lines


def new_run(session: str, flow: Flow, compiled: CompiledFlow, clock: Clock, *, live: bool = True) -> Run:
    """Return the state of a run that begins now, without the status of its sources and sinks."""
    recording = next((each.recording for each in flow.sources().values() if each.recording is not None), None)
    if recording is not None:
        check_sinks_of_replay(flow)
    return Run(
        session,
        flow.name,
        clock,
        clock.now(),
        live=live,
        recording=recording,
        declaration=tuple(declaration(flow)),
        describe={node.name: node.describe() for node in flow.sources()},
        sink_types=compiled.sink_types,
        fingertips=compiled.fingertips,
    )


class ReplayRunner:
    """One run of a flow over a recording at full speed.

    All streams advance together in slices of event time, so that joins see the same rows as in a live run.
    All sinks write a slice before the next one is read. Unlike in a live run, any failure ends the replay: it
    can be repeated. A batch has at most `rows` rows.

    Raises:
        FlowError: if the flow is wired wrongly, or has a sink for live runs only.
        InputError: if the recording lacks a stream.
    """

    def __init__(self, flow: Flow, recording: Recording, session: str, *, rows: int = 1000) -> None:
        self._flow = replayed(flow, recording)
        self.compiled = CompiledFlow(self._flow)
        check_extras(self._flow.sinks())
        self._consumers = consumers(self._flow.nodes)
        self._recording, self._rows = recording, rows
        self._clock = EventClock(0)
        self.run = new_run(session, self._flow, self.compiled, self._clock, live=False)
        self.run.declaration = tuple(declaration(flow))  # as in a live run
        self.run.sources = {node.name: SourceStatus() for node in self._flow.sources()}
        self.run.sinks = {
            node.name: SinkStatus(records=sink.records) for node, sink in self._flow.sinks().items()
        }

    async def execute(self) -> Run:
        """Run to the end of the recording.

        Raises:
            SlipflowError: if an operator, a sink or the recording fails; earlier output is committed.
        """
        recorded: dict[Entry, Iterator[Batch]] = {
            (node, finger): self._recording.read(cast("Source[Any]", node.part).kind, finger, self._rows)
            for node, finger in self.compiled.entries
        }
        slices = in_slices(recorded)
        if (first := next(slices, None)) is None:
            raise InputError(self._recording.name, "is empty: it has no rows to replay")
        self._clock.newest = self.run.start = min(int(batch.time[0]) for batch in first.values())
        opened: list[Sink[Any]] = []
        try:
            for sink in self._flow.sinks().values():
                with contained():
                    await sink.open(self.run)
                opened.append(sink)
            filters = defaultdict[Entry, LateRowFilter](LateRowFilter)  # they only count
            for batches in chain([first], slices):
                deliveries = self.compiled.push(batches)
                for entry, batch in batches.items():
                    status = self.run.sources[entry[0].name]
                    status.up = True
                    count_rows(status, filters[entry], batch)
                    self._clock.newest = max(self._clock.newest, status.newest)
                await self._write(deliveries)
                await asyncio.sleep(0)  # let sinks serve their clients
            await self._write(self.compiled.flush())
        except BaseException as error:  # a cancelled run is incomplete too
            self.run.error = reason_of(error) if isinstance(error, Exception) else "was interrupted"
            await close_sinks(opened, failed=True)
            raise
        finally:
            for status in self.run.sources.values():
                status.up = False
        await close_sinks(opened)
        return self.run

    async def _write(self, deliveries: Sequence[Delivery]) -> None:
        for node, batch in deliveries:
            for reader in self._consumers[node]:
                if isinstance(reader.part, Sink):
                    with contained():
                        await reader.part.write(batch)
                    self.run.sinks[reader.name].rows += len(batch)


async def close_sinks(sinks: Iterable[Sink[Any]], *, failed: bool = False) -> None:
    """Close all sinks, even if one fails; log the errors but the first, or all if the run has `failed`.

    Raises:
        Exception: the first error, unless the run has `failed`: then that error is raised.
    """
    errors = list[Exception]()
    for sink in sinks:
        try:
            with contained():
                await sink.close()
        except Exception as error:  # noqa: BLE001 - the other sinks must be closed too
            errors.append(error)
            if failed or len(errors) > 1:
                log.warning("%s failed: %s", sink.destination, reason_of(error))
    if errors and not failed:
        raise errors[0]


def in_slices(streams: Mapping[Entry, Iterator[Batch]]) -> Iterator[dict[Entry, Batch]]:
    """Cut streams at common times: each slice has the rows of all streams up to the same time.

    A slice ends where the first of the current batches ends, so that at most one batch per stream is kept.
    """
    rest: dict[Entry, Batch] = {}
    while True:
        for entry, stream in streams.items():
            if entry not in rest and (batch := next((b for b in stream if len(b)), None)) is not None:
                rest[entry] = batch
        if not rest:
            return
        newest = {entry: int(batch.time.max()) for entry, batch in rest.items()}
        until = min(newest.values())
        slices: dict[Entry, Batch] = {}
        for entry, batch in list(rest.items()):
            if newest[entry] == until:
                slices[entry] = rest.pop(entry)
                continue
            reached = np.maximum.accumulate(batch.time)  # (n,) late rows stay with the rows before them
            if cut := int(np.searchsorted(reached, until, side="right")):
                slices[entry], rest[entry] = batch[:cut], batch[cut:]
        yield slices


def first_time(flow: Flow, recording: Recording) -> int:
    """Return the first stamp (ns) of the streams that a flow, made by `replayed`, reads from a recording.

    Raises:
        InputError: if there is no row.
    """
    times = (
        int(batch.time[0])
        for source in flow.sources().values()
        for finger in source.fingers
        for batch in islice(recording.read(source.kind, finger, 1), 1)
    )
    if (first := min(times, default=None)) is None:
        raise InputError(recording.name, "is empty: it has no rows to replay")
    return first

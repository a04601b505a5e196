"""Running a flow over a recording: the same graph, as fast as the machine goes, or paced like a live run."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain, islice
from typing import Any, cast

import numpy as np

from connectors.replay import Replay
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Entry
from flows.graph.drawing import streams
from flows.graph.node import Node, Part
from flows.run import log_events
from flows.run.clocks import EventClock
from operators.batch import Batch, Motion, Touch
from operators.errors import InputError
from operators.operator import Order
from operators.ports import Recording, Run, Sink, SinkStatus, Source, SourceStatus


def replayed(flow: Flow, recording: Recording, *, paced: bool = True) -> Flow:
    """The same flow, its sources replaced by what was recorded of them.

    A source takes the recorded fingertips that it declares; the only source of its kind takes all of them.

    Args:
        flow: The flow; it stays as it is.
        recording: What was recorded.
        paced: Whether it will run live: then the streams keep their distance in time, for which the
            beginning of each is read.

    Raises:
        InputError: if the recording holds nothing for one of the sources.
    """
    origin = first_time(recording) if paced else None
    sources = [node.part for node in flow.nodes if isinstance(node.part, Source)]

    def recorded(node: Node) -> Part:
        part = node.part
        if not isinstance(part, Source):
            return part
        kind = cast("type[Batch]", part.kind)
        fingers = recording.fingers(kind)
        if sum(cast("type[Batch]", other.kind) is kind for other in sources) > 1:
            fingers = tuple(finger for finger in fingers if finger in part.fingers)
        if not fingers:
            reason = f"holds no {kind.__name__.lower()} stream, which source {node.name!r} needs"
            raise InputError(recording.name, f"{reason} (flow {flow.name!r})")
        return Replay(recording, kind, fingers, origin=origin)

    return flow.replaced(recorded)


def recorded_of(sources: Iterable[Source[Any]]) -> str | None:
    """The name of what is replayed, if one of the sources gives what was recorded."""
    names = (source.recording for source in sources)
    return next((name for name in names if name is not None), None)


def tell_places(flow: Flow) -> None:
    """Say where the sinks of a flow write in a replay, if that is elsewhere than in a live run."""
    for node in flow.sinks():
        sink = cast("Sink[Any]", node.part)
        if sink.replay_destination != sink.destination:
            log_events.replay_elsewhere(node.name, sink.replay_destination)


class ReplayRunner:
    """One run of a flow over a recording at full speed.

    All streams advance together in slices of event time, so that joins see what they would have seen live;
    each sink takes each batch before the next slice is read. Unlike in a live run any failure ends it: the
    recording is still there to be run over again.
    """

    def __init__(
        self,
        flow: Flow,
        recording: Recording,
        session: str,
        *,
        rows: int = 1000,
        compile_flow: Callable[[Flow], CompiledFlow] = CompiledFlow,
    ) -> None:
        """Get ready to run `flow` over `recording` as `session`, in batches of at most `rows`.

        What `compile_flow` makes of the flow is carried out.

        Raises:
            FlowError: if the flow is wired wrongly.
            InputError: if the recording lacks a stream.
        """
        self._flow = replayed(flow, recording, paced=False)
        self.plan = compile_flow(self._flow)
        self._recording, self._rows = recording, rows
        self._stopping = False
        self._clock = EventClock(0)
        self.run = Run(
            session,
            flow.name,
            self._clock,
            0,
            live=False,
            recording=recorded_of(cast("Source[Any]", node.part) for node in self._flow.sources()),
            declaration=tuple(streams(flow.nodes)),
            sink_types=self.plan.sink_types,
        )
        for node in self._flow.sources():
            self.run.describe[node.name] = cast("Source[Any]", node.part).describe()
            self.run.sources[node.name] = SourceStatus()
        for node in self._flow.sinks():
            self.run.sinks[node.name] = SinkStatus(records=cast("Sink[Any]", node.part).records)

    def stop(self) -> None:
        """End after the slice at hand, as if the recording ended there; the run tells that it did not."""
        self._stopping = True

    async def execute(self, progress: Callable[[Run], object] = lambda _: None) -> Run:
        """Run to the end of the recording, calling `progress` after each slice.

        Raises:
            SlipflowError: of an operator, a sink or the recording; what went before is committed.
        """
        recorded: dict[Entry, Iterator[Batch]] = {
            (node, finger): self._recording.read(cast("Source[Any]", node.part).kind, finger, self._rows)
            for node, finger in self.plan.entries
        }
        slices = in_slices(recorded)
        if (first := next(slices, None)) is None:
            raise InputError(self._recording.name, "is empty: there is no row to replay")
        self._clock.newest = self.run.start = min(int(batch.time[0]) for batch in first.values())
        sinks = {node: cast("Sink[Any]", node.part) for node in self._flow.sinks()}
        order = {entry: Order() for entry in self.plan.entries}
        opened: list[Sink[Any]] = []
        try:
            for sink in sinks.values():
                await sink.open(self.run)
                opened.append(sink)
            for batches in chain([first], slices):
                for entry, batch in batches.items():
                    order[entry].keep(batch)
                    status = self.run.sources[entry[0].name]
                    status.up = True
                    status.newest = max(status.newest, order[entry].newest)
                    status.rows += len(batch)
                    status.late = sum(o.late for (node, _), o in order.items() if node is entry[0])
                    self._clock.newest = max(self._clock.newest, status.newest)
                await self._write(sinks, self.plan.push(batches))
                progress(self.run)
                if self._stopping:
                    self.run.error = "was interrupted"
                    break
            await self._write(sinks, self.plan.flush())
        except BaseException as error:  # cancelled is not complete either
            self.run.error = str(error) or "was interrupted"
            raise
        finally:
            for status in self.run.sources.values():
                status.up = False
            for sink in opened:
                await sink.close()
        return self.run

    async def _write(self, sinks: Mapping[Node, Sink[Any]], deliveries: list[tuple[Node, Batch]]) -> None:
        for node, batch in deliveries:
            await sinks[node].write(batch)
            self.run.sinks[node.name].rows += len(batch)


def in_slices(streams: Mapping[Entry, Iterator[Batch]]) -> Iterator[dict[Entry, Batch]]:
    """Cut streams at common instants: each slice holds what all of them have up to the same time.

    A slice ends where the first of the batches at hand ends, so nothing is held longer than one batch each.
    """
    rest: dict[Entry, Batch] = {}
    while True:
        for entry, stream in streams.items():
            if entry not in rest and (batch := next((b for b in stream if len(b)), None)) is not None:
                rest[entry] = batch
        if not rest:
            return
        until = min(int(batch.time.max()) for batch in rest.values())
        slices: dict[Entry, Batch] = {}
        for entry, batch in list(rest.items()):
            reached = np.maximum.accumulate(batch.time)  # (n,) late rows go with what they came after
            cut = int(np.searchsorted(reached, until, side="right"))
            if cut:
                slices[entry] = batch[:cut]
            if cut == len(batch):
                del rest[entry]
            else:
                rest[entry] = batch[cut:]
        yield slices


def first_time(recording: Recording) -> int:
    """The first stamp of a recording, ns.

    Raises:
        InputError: if it holds nothing.
    """
    times = [
        int(batch.time[0])
        for kind in (Touch, Motion)
        for finger in recording.fingers(kind)
        for batch in islice(recording.read(kind, finger, 1), 1)
    ]
    if not times:
        raise InputError(recording.name, "is empty: there is no row to replay")
    return min(times)

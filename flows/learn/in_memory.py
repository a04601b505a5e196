"""Flows over batches in memory: training and evaluation run the same compiled graph as live runs."""

from collections.abc import AsyncIterator
from typing import TypeVar

from flows.graph.compiled_flow import CompiledFlow
from flows.graph.flow import Flow
from operators.batch import Batch, concat
from operators.ports import Clock, Run, Sink, Source

B = TypeVar("B", bound=Batch)


class BatchSource(Source[B]):
    """Source of one batch that is already in memory."""

    def __init__(self, batch: B) -> None:
        self.batch = batch

    @property
    def kind(self) -> type[B]:
        """Type of the batch."""
        return type(self.batch)

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertip of the batch."""
        return (self.batch.finger,)

    async def batches(self, clock: Clock) -> AsyncIterator[B]:  # noqa: ARG002 - the rows have their times
        """Yield the batch."""
        yield self.batch


class BatchSink(Sink[Batch]):
    """Sink that keeps its batches in memory."""

    def __init__(self) -> None:
        self.batches: list[Batch] = []

    @property
    def destination(self) -> str:
        """Name of the sink, which writes nowhere."""
        return "memory"

    async def open(self, run: Run) -> None:
        """Do nothing."""

    async def write(self, batch: Batch) -> None:
        """Keep a batch."""
        self.batches.append(batch)

    def rows(self, kind: type[B]) -> B:
        """Return all rows of one type."""
        return concat(kind, [batch for batch in self.batches if isinstance(batch, kind)])


def run_in_memory(flow: Flow, sink: BatchSink) -> None:
    """Push the batch of each `BatchSource` of a flow through it, to the end of all streams.

    The batches must cover the same span of time.

    Args:
        flow: Flow whose only sink is `sink`.
        sink: Sink that receives the output.
    """
    compiled = CompiledFlow(flow)
    inputs = {(n, finger): n.part.batch for n, finger in compiled.entries if isinstance(n.part, BatchSource)}
    sink.batches += [batch for _, batch in [*compiled.push(inputs), *compiled.flush()]]

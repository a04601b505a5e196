"""Part of a flow that runs on the cluster, separately for each share of the fingertips."""

from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

from flows.graph import Flow
from flows.graph.node import Node
from operators.batch import Batch
from operators.errors import FlowError
from operators.ports import Clock, Run, Sink, Source
from storage import Dataset

_RESULT: Final = "result-"


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

    async def batches(self, clock: Clock) -> AsyncIterator[Batch]:  # noqa: ARG002 - the port's signature
        """Yield nothing."""
        nothing: tuple[Batch, ...] = ()
        for batch in nothing:
            yield batch


@dataclass(eq=False)
class ResultSink(Sink[Batch]):
    """Placeholder for the datasets that take the rows of an operator; the worker stores them."""

    operator: int  # the operator's index in the flow

    @property
    def destination(self) -> str:
        """Unique name."""
        return f"{_RESULT}{self.operator}"

    async def open(self, run: Run) -> None:
        """Do nothing."""

    async def write(self, batch: Batch) -> None:
        """Do nothing."""


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


def result_nodes(flow: Flow) -> list[Node]:
    """Return the operators whose rows go to sinks, in the order of the flow."""
    inputs = {parent for node in flow.sinks() for parent in node.inputs}
    return [node for node in flow.nodes if node in inputs and not isinstance(node.part, Source)]


def segment(flow: Flow, fingers: Mapping[str, tuple[int, ...]]) -> Flow:
    """Return a copy of the flow's operators between a `UnitSource` per source and a `ResultSink` per result.

    Args:
        flow: Flow to copy from; it is not changed.
        fingers: Fingertips of each source, by the name of its node.
    """
    part = Flow(flow.name)
    copies: dict[Node, Node] = {}

    def copy(node: Node) -> Node:
        if node not in copies:
            inputs = [copy(parent) for parent in node.inputs]
            placeholder: Any = node.part
            if isinstance(placeholder, Source):
                placeholder = UnitSource(cast("type[Batch]", node.gives), fingers[node.name])
            copies[node] = Node(node.name, placeholder, inputs)
            part.nodes.append(copies[node])
        return copies[node]

    for node in result_nodes(flow):
        number = flow.nodes.index(node)
        part.nodes.append(Node(f"{_RESULT}{number}", ResultSink(number), [copy(node)]))
    return part


def needed_sources(flow: Flow) -> set[str]:
    """Return the names of the sources that feed `result_nodes`."""
    found, rest = set[str](), list(result_nodes(flow))
    while rest:
        node = rest.pop()
        rest += node.inputs
        if isinstance(node.part, Source):
            found.add(node.name)
    return found

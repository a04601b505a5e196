"""Declaring a flow: sources, operators joined by ``|`` and ``&``, and sinks.

Building a flow runs nothing; a runner carries it out, as often as wanted, with fresh operators each time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias, TypeVar, cast, get_args, get_type_hints

from operators.batch import EVERY, Batch
from operators.operator import Join, Operator, input_types, output_type
from operators.ports import Sink, Source

B = TypeVar("B", bound=Batch, covariant=True)
C = TypeVar("C", bound=Batch, covariant=True)
Out = TypeVar("Out", bound=Batch)
Part: TypeAlias = Source[Any] | Operator[Any, Any] | Join[Any, Any, Any] | Sink[Any]


@dataclass(eq=False)
class Node:
    """One part of a flow and what feeds it."""

    name: str  # of a source or sink: unique in the flow; of an operator: its class
    part: Part
    inputs: list["Node"] = field(default_factory=list["Node"])

    @property
    def takes(self) -> tuple[type[Batch], ...]:
        """The batch types that it takes: one for each input of an operator, the choice that a sink has."""
        if isinstance(self.part, Operator | Join):
            return input_types(type(self.part))
        if isinstance(self.part, Sink):
            hint: Any = get_type_hints(type(self.part).write)["batch"]
            return cast("tuple[type[Batch], ...]", get_args(hint) or (hint,))
        return ()

    @property
    def gives(self) -> type[Batch] | None:
        """The batch type that it gives; None for a sink."""
        if isinstance(self.part, Source):
            return cast("type[Batch]", self.part.kind)
        return None if isinstance(self.part, Sink) else output_type(type(self.part))

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertips that its batches belong to; what belongs to every one joins each of them."""
        if isinstance(self.part, Source):
            return self.part.fingers
        found = {finger for parent in self.inputs for finger in parent.fingers}
        return tuple(sorted(found - {EVERY})) or (EVERY,)


class Flow:
    """A graph of sources, operators and sinks.

    >>> from flows.testing import TestSink, TestSource
    >>> from operators import Debounce, Scores
    >>> flow = Flow("felt")
    >>> scores = flow.source(TestSource(Scores))
    >>> slips = scores | Debounce(consecutive=3)
    >>> slips.to(TestSink())
    >>> print(flow)
    flow felt
      scores = TestSource(Scores)
      slips  = scores | Debounce(consecutive=3)
      slips -> TestSink()
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.nodes: list[Node] = []

    def source(self, source: Source[Out], name: str = "") -> "Stream[Out]":
        """The stream that a source gives; its name is that of its batch type if not given."""
        return Stream(self, self.add(name or source.kind.__name__.lower(), source))

    def sources(self) -> list[Node]:
        """The nodes that feed the flow."""
        return [node for node in self.nodes if isinstance(node.part, Source)]

    def sinks(self) -> list[Node]:
        """The nodes that take what the flow gives."""
        return [node for node in self.nodes if isinstance(node.part, Sink)]

    def consumers(self) -> Mapping[Node, list[Node]]:
        """For each node, those that it feeds."""
        fed: dict[Node, list[Node]] = {node: [] for node in self.nodes}
        for node in self.nodes:
            for parent in node.inputs:
                fed.setdefault(parent, []).append(node)
        return fed

    def __str__(self) -> str:
        from flows.drawing import text  # noqa: PLC0415 - the drawing knows the graph, not the other way round

        return text(self)

    def add(self, name: str, part: Part, *inputs: Node) -> Node:
        """Add a part behind others; what ``|`` and `source` do."""
        if isinstance(part, Source | Sink):
            taken = {node.name for node in self.nodes}
            name = next(
                n for n in (name, *(f"{name}{k}" for k in range(2, len(taken) + 3))) if n not in taken
            )
        self.nodes.append(node := Node(name, part, list(inputs)))
        return node

    def add_sink(self, sink: Sink[Any], stream: Node) -> None:
        """Send a stream to a sink, a new one or one that takes others already; what `Stream.to` does."""
        for node in self.sinks():
            if node.part is sink:
                node.inputs.append(stream)
                return
        self.add(type(sink).__name__.lower(), sink, stream)


@dataclass(frozen=True, eq=False)
class Stream(Generic[B]):
    """What a node of a flow gives: batches of one type."""

    flow: Flow
    node: Node

    def __or__(self, operator: Operator[B, Out]) -> "Stream[Out]":
        """Pass this stream through an operator."""
        return Stream(self.flow, self.flow.add(type(operator).__name__, operator, self.node))

    def __and__(self, other: "Stream[C]") -> "Pair[B, C]":
        """Pair this stream with another, for a join."""
        return Pair(self, other)

    def to(self, sink: Sink[B]) -> None:
        """Send this stream to a sink; one sink may take several streams."""
        self.flow.add_sink(sink, self.node)


@dataclass(frozen=True, eq=False)
class Pair(Generic[B, C]):
    """Two streams on their way into a join."""

    left: Stream[B]
    right: Stream[C]

    def __or__(self, join: Join[B, C, Out]) -> Stream[Out]:
        """Join the two streams."""
        flow = self.left.flow
        return Stream(flow, flow.add(type(join).__name__, join, self.left.node, self.right.node))

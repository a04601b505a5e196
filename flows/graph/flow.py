"""Declaration of a flow: sources, operators connected by ``|`` and ``&``, and sinks.

Building a flow runs nothing. Runners execute it any number of times, each time with new operators.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Generic, Never, NoReturn, TypeVar, cast

from flows.graph.drawing import text
from flows.graph.node import FlowPart, Node
from operators.batch import Batch
from operators.errors import FlowError
from operators.operator import Join, Operator
from operators.ports import Sink, Source

B = TypeVar("B", bound=Batch, covariant=True)
C = TypeVar("C", bound=Batch, covariant=True)
Out = TypeVar("Out", bound=Batch)
_USES: Final[dict[type, tuple[str, str]]] = {  # kinds of parts: base class, and how a flow takes them
    Source: ("Source[Out]", "flow.source({}())"),
    Operator: ("Operator[In, Out]", "stream | {}()"),
    Join: ("Join[Left, Right, Out]", "left & right | {}()"),
    Sink: ("Sink[In]", "stream.to({}())"),
}


class Flow:
    """Graph of sources, operators and sinks.

    >>> from flows.graph.testing import TestSink, TestSource
    >>> from operators import Debounce, Scores
    >>> flow = Flow("events")
    >>> scores = flow.source(TestSource(Scores))
    >>> slips = scores | Debounce(consecutive=3)
    >>> _ = slips.to(TestSink())
    >>> print(flow)
    flow events
      scores = TestSource(Scores)
      slips  = scores | Debounce(consecutive=3)
      slips -> TestSink()
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.code = ""  # checksum of the file that declares it and of the modules next to it; empty: unknown
        self.nodes: list[Node] = []

    def source(self, source: Source[Out], name: str = "") -> "Stream[Out]":
        """Add a source and return its stream; `name` defaults to the batch type in lower case."""
        _check_part(self, Source, source)
        return Stream(self, self.add(name or source.kind.__name__.lower(), source))

    def sources(self) -> dict[Node, Source[Any]]:
        """Return the sources by their nodes."""
        return {node: node.part for node in self.nodes if isinstance(node.part, Source)}

    def sinks(self) -> dict[Node, Sink[Any]]:
        """Return the sinks by their nodes."""
        return {node: node.part for node in self.nodes if isinstance(node.part, Sink)}

    def __str__(self) -> str:
        return text(self.name, self.nodes)

    def replaced(self, choose: Callable[[Node], FlowPart]) -> "Flow":
        """Return a copy of the flow in which `choose` selects the part of each node."""
        copies = {node: Node(node.name, choose(node)) for node in self.nodes}
        for node, copy in copies.items():
            copy.inputs += [copies[parent] for parent in node.inputs]
        flow = Flow(self.name)
        flow.code = self.code
        flow.nodes += copies.values()
        return flow

    def add(self, name: str, part: FlowPart, *inputs: Node) -> Node:
        """Add a part that reads from `inputs`; ``|`` and `source` call this."""
        if isinstance(part, Source | Sink):
            taken = {node.name for node in self.nodes}
            name = next(
                n for n in (name, *(f"{name}{k}" for k in range(2, len(taken) + 3))) if n not in taken
            )
        self.nodes.append(node := Node(name, part, list(inputs)))
        return node

    def add_sink(self, sink: Sink[Any], stream: Node) -> None:
        """Connect a stream to a new or an existing sink; `Stream.to` calls this."""
        _check_part(self, Sink, sink, stream)
        for node, known in self.sinks().items():
            if known is sink:
                if stream not in node.inputs:  # else it would get each row twice
                    node.inputs.append(stream)
                return
        self.add(type(sink).__name__.lower(), sink, stream)


@dataclass(frozen=True, eq=False)
class Stream(Generic[B]):
    """Output of a node: batches of one type."""

    flow: Flow
    node: Node

    def __or__(self, operator: Operator[B, Out]) -> "Stream[Out]":
        """Apply an operator to this stream."""
        _check_part(self.flow, Operator, operator, self.node)
        return Stream(self.flow, self.flow.add(type(operator).__name__, operator, self.node))

    def __and__(self, other: "Stream[C]") -> "Pair[B, C]":
        """Pair this stream with another of the same flow, for a join."""
        if not isinstance(cast("object", other), Stream):
            raise self._no_stream(other, f"{self.node.name} & {{}}")
        if other.flow is not self.flow:
            reason = f"{other.node.name} belongs to flow {other.flow.name!r}: declare both in one flow"
            raise FlowError(self.flow.name, f"{self.node.name} & {other.node.name}", reason)
        return Pair(self, other)

    def __rand__(self, other: Never) -> NoReturn:
        """Raise an error: ``stream | Zero() & other`` pairs the operator, not the stream."""
        raise self._no_stream(other, f"{{}} & {self.node.name}")

    def _no_stream(self, part: object, pair: str) -> FlowError:
        name = type(part).__name__
        fix = pair.format("(left & right | Align())" if isinstance(part, Pair) else f"(stream | {name}())")
        return FlowError(self.flow.name, pair.format(name), f"{name} is not a stream: write {fix}")

    def to(self, sink: Sink[B]) -> "Stream[B]":
        """Send this stream to a sink, and return it; one sink may receive several streams."""
        self.flow.add_sink(sink, self.node)
        return self


@dataclass(frozen=True, eq=False)
class Pair(Generic[B, C]):
    """Pair of streams to join."""

    left: Stream[B]
    right: Stream[C]

    def __or__(self, join: Join[B, C, Out]) -> Stream[Out]:
        """Join the two streams."""
        flow, inputs = self.left.flow, (self.left.node, self.right.node)
        _check_part(flow, Join, join, *inputs)
        return Stream(flow, flow.add(type(join).__name__, join, *inputs))


def _check_part(flow: Flow, kind: type, part: object, *inputs: Node) -> None:
    """Raise an error if a part is not of the kind that its position in the flow requires."""
    if isinstance(part, kind):
        return
    name = getattr(part, "__name__", type(part).__name__)
    attributes: dict[str, object] = getattr(part, "__dict__", {})  # perhaps of a rig
    edge = " -> ".join(filter(None, [" & ".join(each.name for each in inputs), name]))
    reason = f"{name} is not of type {kind.__name__}: derive its class from {_USES[kind][0]}"
    if isinstance(part, type) and issubclass(part, tuple(_USES)):
        reason = f"{name} is a class: write {name}()"
    elif other := next((each for each in _USES if isinstance(part, each)), None):
        reason = f"{name} is of type {other.__name__}: write {_USES[other][1].format(name)}"
    elif kind is Source and (found := [n for n, each in attributes.items() if isinstance(each, Source)]):
        has = ", ".join(found)
        reason = f"{name} is not of type Source, but has {has}: write flow.source(rig.{found[0]})"
    raise FlowError(flow.name, edge, reason)

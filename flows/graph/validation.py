"""Finding what is wrong with a flow before it runs."""

from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from flows.graph.flow import Flow
from flows.graph.node import Node, consumers
from operators.batch import Batch
from operators.errors import FlowError
from operators.operator import Join, Operator
from operators.ports import Sink, Source


def validate(flow: Flow) -> None:
    """Raise the first problem of a flow, if it has one.

    Raises:
        FlowError: naming the edge and what is wrong with it.
    """
    for problem in problems(flow):
        raise problem


def problems(flow: Flow) -> list[FlowError]:
    """All that is wrong with a flow; types and places are looked at only where its shape is sound."""
    shape = [
        *_no_source(flow),
        *_foreign(flow),
        *_unconnected(flow),
        *_cycles(flow),
        *_shared_parts(flow),
        *_shared_state(flow),
    ]
    return shape or [*_wrong_types(flow), *_shared_places(flow), *_same_streams(flow)]


def _edge(parent: Node, node: Node) -> str:
    return f"{parent.name} -> {node.name}"


def _no_source(flow: Flow) -> Iterator[FlowError]:
    if not flow.sources():
        yield FlowError(flow.name, "no source", "add one with flow.source(...)")


def _foreign(flow: Flow) -> Iterator[FlowError]:
    own = set(flow.nodes)
    for node in flow.nodes:
        for parent in node.inputs:
            if parent not in own:
                yield FlowError(flow.name, _edge(parent, node), f"{parent.name} belongs to another flow")


def _unconnected(flow: Flow) -> Iterator[FlowError]:
    for node, takers in consumers(flow.nodes).items():
        if not takers and not isinstance(node.part, Sink) and node in flow.nodes:
            kind = node.gives.__name__ if node.gives else "nothing"
            yield FlowError(
                flow.name,
                f"{node.name} -> ?",
                f"its stream of {kind} is unconnected: give it a sink with .to(...)",
            )


def _cycles(flow: Flow) -> Iterator[FlowError]:
    done: set[Node] = set()

    def visit(node: Node, path: list[Node]) -> Iterator[FlowError]:
        if node in path:
            circle = [*path[path.index(node) :], node]
            names = " -> ".join(n.name for n in reversed(circle))
            yield FlowError(flow.name, names, "is a cycle: a stream cannot feed itself")
        elif node not in done:
            for parent in node.inputs:
                yield from visit(parent, [*path, node])
            done.add(node)

    for node in flow.nodes:
        yield from visit(node, [])


def _shared_parts(flow: Flow) -> Iterator[FlowError]:
    seen: dict[int, Node] = {}
    for node in flow.nodes:
        first = seen.setdefault(id(node.part), node)
        if first is not node:
            kind = "source" if isinstance(node.part, Source) else "operator"
            where = _edge(node.inputs[0], node) if node.inputs else node.name
            yield FlowError(
                flow.name,
                where,
                f"the same {kind} object stands in two places: share its stream, or make two",
            )


def _shared_state(flow: Flow) -> Iterator[FlowError]:
    for node in flow.nodes:
        if isinstance(node.part, Operator | Join):
            for f in fields(node.part):
                if f.init and isinstance(getattr(node.part, f.name), list | dict | set | np.ndarray):
                    reason = (
                        f"{f.name} would be shared by all runs: a parameter is a tuple, state has init=False"
                    )
                    yield FlowError(flow.name, node.name, reason)


def _wrong_types(flow: Flow) -> Iterator[FlowError]:
    for node in flow.nodes:
        wanted = node.takes
        for i, parent in enumerate(node.inputs):
            if (given := parent.gives) is None:
                continue
            choice = wanted[i : i + 1] if isinstance(node.part, Operator | Join) else wanted
            if not issubclass(given, choice):
                names = " or ".join(kind.__name__ for kind in choice)
                yield FlowError(
                    flow.name, _edge(parent, node), f"{node.name} takes {names}, not {given.__name__}"
                )


def _shared_places(flow: Flow) -> Iterator[FlowError]:
    places: dict[str, Node] = {}
    for node in flow.sinks():
        if not isinstance(node.part, Sink):
            continue
        first = places.setdefault(node.part.destination, node)
        if first is not node:
            where, other = (
                _edge(each.inputs[0], each) if each.inputs else each.name for each in (node, first)
            )
            reason = f"writes to {node.part.destination}, and so does {other}: use one sink for both"
            yield FlowError(flow.name, where, reason)


def _same_streams(flow: Flow) -> Iterator[FlowError]:
    for node in flow.sinks():
        seen: dict[tuple[type[Batch] | None, int], Node] = {}
        for parent in node.inputs:
            for finger in parent.fingers:
                first = seen.setdefault((parent.gives, finger), parent)
                if first is not parent and parent.gives:
                    yield FlowError(
                        flow.name,
                        _edge(parent, node),
                        f"{node.name} already takes {parent.gives.__name__} from {first.name}",
                    )

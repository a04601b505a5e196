"""Fingertips of a flow's streams, and checks that its operators and sinks fit them."""

from collections.abc import Sequence
from typing import Any, cast

from flows.graph.node import Node
from operators.batch import Batch, Touch
from operators.errors import FingertipError, FlowError
from operators.fingertip import Fingertip
from operators.operator import Join, Operator
from operators.ports import Sink, Source


def trace_fingertips(flow: str, nodes: Sequence[Node]) -> tuple[dict[Node, Fingertip], list[FlowError]]:
    """Return the fingertip of each stream, where it is known, and the edges that do not fit.

    Args:
        flow: Name of the flow, for the errors.
        nodes: Its nodes, each after its inputs.
    """
    found, problems = dict[Node, Fingertip](), list[FlowError]()
    for node in nodes:
        try:
            fingertip = _of_output(node, found)
        except FingertipError as error:
            problem = FlowError(flow, f"{node.inputs[0].name} -> {node.name}", str(error))
            problem.__cause__ = error
            problems.append(problem)
            continue
        if fingertip is not None:
            found[node] = fingertip
    return found, problems


def sink_fingertips(nodes: Sequence[Node]) -> dict[str, dict[type[Batch], Fingertip]]:
    """Return the fingertips of the touch streams of each sink, by its destination and their type."""
    found, _ = trace_fingertips("", nodes)
    return {
        node.part.destination: {
            kind: found[parent]
            for parent in node.inputs
            if parent in found and issubclass(kind := cast("type[Batch]", parent.gives), Touch)
        }
        for node in nodes
        if isinstance(node.part, Sink)
    }


def _of_output(node: Node, known: dict[Node, Fingertip]) -> Fingertip | None:
    if isinstance(node.part, Source):
        return node.part.fingertip
    given = next((known[parent] for parent in node.inputs if parent in known), None)
    if given is None or not isinstance(node.part, Operator | Join):
        return None
    return cast("Operator[Any, Any]", node.part).output_fingertip(given)

"""Checks of a flow before it runs, and the fingertips of its streams."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import Field, fields
from functools import cache
from inspect import getattr_static, iscoroutinefunction, isgeneratorfunction, signature
from typing import Any, Final, TypeAlias, cast

import numpy as np

from flows.graph.flow import Flow
from flows.graph.node import Node, consumers
from operators.batch import EVERY, Batch, Touch
from operators.debounce import Debounce
from operators.errors import FingertipError, FlowError
from operators.fingertip import Fingertip
from operators.operator import AnyOperator, Join, Operator, input_types, output_type
from operators.ports import Sink, Source
from operators.score import Score
from operators.zero import Zero

Problem: TypeAlias = tuple[str, str]  # edge and reason

_CHAIN: Final[tuple[type[Operator[Any, Any]], ...]] = (Zero, Score, Debounce)


def validate(flow: Flow, *, fingertips: bool = True) -> None:
    """Raise the first problem of a flow, if there is one.

    `fingertips` checks that those of the sources fit; a replay replaces the sources.

    Raises:
        FlowError: naming the edge, the mistake and the fix.
    """
    for problem in problems(flow, fingertips=fingertips):
        raise problem


def problems(flow: Flow, *, fingertips: bool = True) -> list[FlowError]:
    """Return all problems of a flow; the wiring is checked only if its operators and sinks are valid."""
    parts = _wrong_sources, _wrong_operators, _wrong_sinks
    streams = _no_source, _shared_parts, _wrong_types, _unconnected
    wiring = *streams, _shared_destinations, _duplicate_streams

    def found(checks: Iterable[Callable[[Flow], Iterator[Problem]]]) -> list[FlowError]:
        return [FlowError(flow.name, *problem) for check in checks for problem in check(flow)]

    if wrong := found(parts):
        return wrong
    return found(wiring) + ([*trace_fingertips(flow)[1], *found([_apart])] if fingertips else [])


def trace_fingertips(flow: Flow) -> tuple[dict[Node, Fingertip], list[FlowError]]:
    """Return the fingertip of each stream, where it is known, and the edges that do not fit."""
    found, problems = dict[Node, Fingertip](), list[FlowError]()
    for node in flow.nodes:  # each after its inputs
        try:
            fingertip = _of_output(node, found)
        except FingertipError as error:
            problem = FlowError(flow.name, _edge(node.inputs[0], node), str(error))
            problem.__cause__ = error
            problems.append(problem)
            continue
        if fingertip is not None:
            found[node] = fingertip
    return found, problems


def sink_fingertips(flow: Flow) -> dict[str, dict[type[Batch], Fingertip]]:
    """Return the fingertips of the touch streams of each sink, by its destination and their type."""
    found, _ = trace_fingertips(flow)
    return {
        sink.destination: {
            kind: found[parent]
            for parent in node.inputs
            if parent in found and issubclass(kind := cast("type[Batch]", parent.gives), Touch)
        }
        for node, sink in flow.sinks().items()
    }


def _of_output(node: Node, known: dict[Node, Fingertip]) -> Fingertip | None:
    if isinstance(node.part, Source):
        return node.part.fingertip
    given = next((known[parent] for parent in node.inputs if parent in known), None)
    if given is None or not isinstance(node.part, Operator | Join):
        return None
    return cast("Operator[Any, Any]", node.part).output_fingertip(given)


def _apart(flow: Flow) -> Iterator[Problem]:
    """Find joins whose inputs have no fingertip in common, and are not for every fingertip."""
    for node in flow.nodes:
        if isinstance(node.part, Join):
            left, right = (set(parent.fingers) for parent in node.inputs)
            if left and right and EVERY not in left | right and not left & right:
                has = f"fingertips {sorted(left)} never meet {sorted(right)}"
                reason = f"{has}: join streams of the same fingertip, or set fingers of the sources"
                yield f"{' & '.join(parent.name for parent in node.inputs)} -> {node.name}", reason


def _edge(parent: Node, node: Node) -> str:
    return f"{parent.name} -> {node.name}"


def _first_edge(node: Node) -> str:
    return _edge(node.inputs[0], node) if node.inputs else node.name


def _no_source(flow: Flow) -> Iterator[Problem]:
    if not flow.sources():
        yield "no source", "add one with flow.source(...)"


def _unconnected(flow: Flow) -> Iterator[Problem]:
    for node, takers in consumers(flow.nodes).items():
        if not takers and not isinstance(node.part, Sink):
            kind = node.gives.__name__ if node.gives else "nothing"
            reason = f"its stream of {kind} is unconnected: connect it to a sink with .to(...)"
            yield f"{node.name} -> ?", reason


def _shared_parts(flow: Flow) -> Iterator[Problem]:
    seen: dict[int, Node] = {}
    for node in flow.nodes:
        if seen.setdefault(id(node.part), node) is not node:
            kind = "source" if isinstance(node.part, Source) else "operator"
            reason = f"the same {kind} object is used twice: share its stream, or create a second one"
            yield _first_edge(node), reason


def _wrong_sources(flow: Flow) -> Iterator[Problem]:
    """Find methods and fingertips of sources that would fail in a run."""
    for node, source in flow.sources().items():
        if isgeneratorfunction(source.batches) or iscoroutinefunction(source.batches):
            yield node.name, "batches must be declared with async def and contain yield"
        if isinstance(fingers := getattr_static(source, "fingers"), int):  # a property may open a recording
            yield node.name, f"fingers is {fingers!r}, must be a tuple, such as (0,)"


def _wrong_operators(flow: Flow) -> Iterator[Problem]:
    """Find parameters and state that a copy of an operator for a run would share or lack."""
    for node in flow.nodes:
        if not isinstance(node.part, Operator | Join):
            continue
        for name in (name for name, value in vars(type(node.part)).items() if isinstance(value, Field)):
            yield node.name, f"{name} has no value: write @dataclass above class {type(node.part).__name__}"
        parameters = [f.name for f in fields(node.part) if f.init]
        for name in [*parameters, *_class_attributes(type(node.part))]:
            if isinstance(getattr(node.part, name, None), list | dict | set | np.ndarray):
                reason = "use a tuple, or for state a field with init=False"
                yield node.name, f"{name} would be shared by all runs: {reason}"
        if not all(hasattr(node.part, f.name) for f in fields(AnyOperator)):
            yield node.name, "its __init__ lacks super().__init__(): use a @dataclass, which needs neither"
        elif type(node.part).reset_copy is AnyOperator.reset_copy:
            for lost in _parameters(type(node.part)) - {*parameters}:
                yield node.name, f"{lost} would be lost: make it a field of a @dataclass without __init__"


def _class_attributes(kind: type[AnyOperator]) -> list[str]:
    """Return the names to which a class, not an instance, gives values, without those of constants."""
    known = kind.__annotations__
    return [name for name in vars(kind) if name.islower() and "__" not in name and name not in known]


@cache  # of each class: `signature` takes longer than all other checks
def _parameters(kind: type[AnyOperator]) -> frozenset[str]:
    return frozenset(signature(kind).parameters)


def _wrong_sinks(flow: Flow) -> Iterator[Problem]:
    """Find methods and destinations of sinks that would fail in a run."""
    for node, sink in flow.sinks().items():
        edge = _first_edge(node)
        if not all(isinstance(cast("object", kind), type) and issubclass(kind, Batch) for kind in node.takes):
            yield edge, "lacks a batch type: annotate it, as in async def write(self, batch: Slips) -> None"
        for name in ("open", "write", "close", "take"):
            wanted = "def" if name == "take" else "async def"
            if iscoroutinefunction(getattr(sink, name)) != (wanted == "async def"):
                yield edge, f"{name} must be declared with {wanted}"
        if not isinstance(cast("object", sink.destination), str):
            yield edge, "destination must be a text: make it an attribute or a @property"


def _wrong_types(flow: Flow) -> Iterator[Problem]:
    for node in flow.nodes:
        wanted = node.takes
        for i, parent in enumerate(node.inputs):
            if (given := parent.gives) is None:
                continue
            choice = wanted[i : i + 1] if isinstance(node.part, Operator | Join) else wanted
            if not issubclass(given, choice):
                names = " or ".join(kind.__name__ for kind in choice)
                reason = f"{node.name} takes {names}, not {given.__name__}{_missing(given, choice)}"
                yield _edge(parent, node), reason


def _missing(given: type[Batch], wanted: tuple[type[Batch], ...]) -> str:
    """Suggest the operators of the usual chain that convert one type to another, if there are any."""
    starts = [i for i, operator in enumerate(_CHAIN) if issubclass(given, input_types(operator))]
    ends = [i for i, operator in enumerate(_CHAIN) if issubclass(output_type(operator), wanted)]
    names = [operator.__name__ for operator in _CHAIN[starts[-1] : ends[0] + 1]] if starts and ends else []
    return f": insert {' and '.join(names)}" if names else ""


def _shared_destinations(flow: Flow) -> Iterator[Problem]:
    users: dict[str, Node] = {}
    for node, sink in flow.sinks().items():
        first = users.setdefault(sink.destination, node)
        if first is not node:
            other = _first_edge(first)
            reason = f"writes to {sink.destination}, as does {other}: use one sink for both"
            yield _first_edge(node), reason


def _duplicate_streams(flow: Flow) -> Iterator[Problem]:
    for node in flow.sinks():
        seen: dict[tuple[type[Batch] | None, int], Node] = {}
        kinds = [parent.gives for parent in node.inputs]
        for parent in node.inputs:
            for finger in parent.fingers if kinds.count(parent.gives) > 1 else ():  # they may have to be read
                first = seen.setdefault((parent.gives, finger), parent)
                if first is not parent and parent.gives:
                    reason = f"already receives {parent.gives.__name__} (from {first.name}): use another sink"
                    yield _edge(parent, node), reason

"""Drawing of a flow: text that reads like the declaration."""

from collections.abc import Sequence
from dataclasses import MISSING, fields, is_dataclass
from types import FunctionType
from typing import Any

from flows.graph.node import Node, consumers
from operators.batch import ms
from operators.operator import Join
from operators.ports import Sink, Source
from storage.description import plain_text


def describe(part: object) -> str:
    """Return a source, operator or sink as text, with the parameters that differ from their defaults.

    >>> from operators import Align, ms
    >>> describe(Align(within=15 * ms))
    'Align(within=15 ms)'
    """
    if not is_dataclass(part):
        has_text, destination = type(part).__str__ is not object.__str__, getattr(part, "destination", "")
        return str(part) if has_text else f"{type(part).__name__}({destination})"
    shown: list[str] = []
    for f in (f for f in fields(part) if f.init and f.repr):
        value: Any = getattr(part, f.name)
        default = f.default_factory() if f.default_factory is not MISSING else f.default
        if default is MISSING or _value(value) != _value(default):  # arrays have no single truth value
            shown.append(_value(value) if default is MISSING else f"{f.name}={_value(value)}")
    return f"{type(part).__name__}({', '.join(shown)})"


def _value(value: object) -> str:
    if isinstance(value, type | FunctionType):
        return value.__name__
    if isinstance(value, int) and not isinstance(value, bool) and value >= ms and value % ms == 0:
        return f"{value // ms} ms"
    if is_dataclass(value):
        return describe(value)
    named = getattr(value, "model", None) or getattr(value, "name", None)  # the model of a detector
    return named if isinstance(named, str) and not isinstance(value, str) else plain_text(value)


def text(name: str, nodes: Sequence[Node]) -> str:
    """Return a flow as text that reads like its declaration; streams are named after their batch type."""
    names = _names(nodes)
    lines = [f"flow {name}", *(f"  {line}" for line in streams(nodes))]
    for node in nodes:
        if isinstance(node.part, Sink):
            taken = [names.get(parent, parent.name) for parent in node.inputs]
            lines += [f"  {stream} -> {describe(node.part)}" for stream in taken]
    return "\n".join(lines)


def streams(nodes: Sequence[Node]) -> list[str]:
    """Return the definition of each named stream, one line each, without the sinks."""
    names = _names(nodes)
    width = max(map(len, names.values()), default=0)

    def chain(node: Node) -> str:
        inputs = [names[parent] if parent in names else chain(parent) for parent in node.inputs]
        return f"{' & '.join(inputs)} | {describe(node.part)}"

    return [
        f"{name:<{width}} = {describe(node.part) if isinstance(node.part, Source) else chain(node)}"
        for node, name in names.items()
    ]


def _names(nodes: Sequence[Node]) -> dict[Node, str]:
    """Return the names of all streams except those that feed exactly one operator."""
    fed, names = consumers(nodes), dict[Node, str]()
    for node in nodes:
        takers = fed[node]
        if isinstance(node.part, Source):
            names[node] = node.name
        elif not isinstance(node.part, Sink) and (
            len(takers) != 1 or isinstance(takers[0].part, Sink | Join)
        ):
            base, taken = (node.gives or type(node)).__name__.lower(), set(names.values())
            free = (base, *(f"{base}{k}" for k in range(2, len(taken) + 3)))
            names[node] = next(name for name in free if name not in taken)
    return names

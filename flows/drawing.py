"""Drawing a flow: as text that reads like its declaration, and as Mermaid."""

from collections.abc import Sequence
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

from flows.node import Node, consumers
from operators.batch import ms
from operators.operator import Join
from operators.ports import Sink, Source


def describe(part: object) -> str:
    """A part with those of its parameters that differ from their defaults.

    >>> from operators import Align, ms
    >>> describe(Align(within=15 * ms))
    'Align(within=15 ms)'
    """
    if not is_dataclass(part):
        place: object = getattr(part, "place", "")
        return str(part) if type(part).__str__ is not object.__str__ else f"{type(part).__name__}({place})"
    shown: list[str] = []
    for f in fields(part):
        value: Any = getattr(part, f.name)
        default = f.default_factory() if f.default_factory is not MISSING else f.default
        if f.init and f.repr and (default is MISSING or value != default):
            shown.append(_value(value) if default is MISSING else f"{f.name}={_value(value)}")
    return f"{type(part).__name__}({', '.join(shown)})"


def _value(value: object) -> str:
    if isinstance(value, type):
        return value.__name__
    if isinstance(value, int) and not isinstance(value, bool) and value >= ms and value % ms == 0:
        return f"{value // ms} ms"
    if is_dataclass(value):
        return describe(value)
    named = getattr(value, "name", None)
    return named if isinstance(named, str) and not isinstance(value, str) else repr(value)


def text(name: str, nodes: Sequence[Node]) -> str:
    """A flow as its declaration would read; a stream is named by what flows in it."""
    fed, names, lines = consumers(nodes), dict[Node, str](), list[tuple[str, str]]()

    def chain(node: Node) -> str:
        if node in names:
            return names[node]
        return " & ".join(chain(parent) for parent in node.inputs) + " | " + describe(node.part)

    for node in nodes:
        if isinstance(node.part, Sink):
            continue
        takers = fed[node]
        if isinstance(node.part, Source):
            names[node] = node.name
            lines.append((node.name, describe(node.part)))
        elif len(takers) != 1 or isinstance(takers[0].part, Sink | Join):
            drawn = chain(node)
            base, taken = (node.gives or type(node)).__name__.lower(), set(names.values())
            names[node] = next(
                n for n in (base, *(f"{base}{k}" for k in range(2, len(taken) + 3))) if n not in taken
            )
            lines.append((names[node], drawn))
    width = max((len(name) for name, _ in lines), default=0)
    drawn_lines = [f"flow {name}", *(f"  {name:<{width}} = {drawn}" for name, drawn in lines)]
    for node in nodes:
        if isinstance(node.part, Sink):
            drawn_lines += [
                f"  {names.get(parent, parent.name)} -> {describe(node.part)}" for parent in node.inputs
            ]
    return "\n".join(drawn_lines)


def mermaid(nodes: Sequence[Node]) -> str:
    """A flow as a Mermaid flowchart, each edge named by what flows along it."""
    number = {node: f"n{i}" for i, node in enumerate(nodes)}
    lines = ["flowchart LR"]
    for node in nodes:
        left, right = ("([", "])") if isinstance(node.part, Source | Sink) else ("[", "]")
        label = describe(node.part).replace('"', "'")
        lines.append(f'    {number[node]}{left}"{label}"{right}')
    for node in nodes:
        for parent in node.inputs:
            kind = parent.gives.__name__ if parent.gives else ""
            lines.append(f"    {number.get(parent, parent.name)} -->|{kind}| {number[node]}")
    return "\n".join(lines)

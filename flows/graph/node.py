"""One part of a flow, and what feeds it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast, get_args, get_type_hints

from operators.batch import EVERY, Batch
from operators.errors import ParameterError
from operators.operator import Join, Operator, input_types, output_type
from operators.ports import Sink, Source

Part: TypeAlias = Source[Any] | Operator[Any, Any] | Join[Any, Any, Any] | Sink[Any]


@dataclass(eq=False)
class Node:
    """One part of a flow and what feeds it."""

    name: str  # of a source or sink: unique in the flow; of an operator: its class
    part: Part
    inputs: list["Node"] = field(default_factory=list["Node"])

    @property
    def takes(self) -> tuple[type[Batch], ...]:
        """The batch types that it takes: one for each input of an operator, the choice that a sink has.

        Raises:
            ParameterError: if it does not declare them.
        """
        if isinstance(self.part, Operator | Join):
            return input_types(type(self.part))
        if isinstance(self.part, Sink):
            hints: dict[str, Any] = get_type_hints(type(self.part).write)
            hint = hints.get(next(iter(hints), ""))  # of the first parameter, whatever its name
            kinds: tuple[Any, ...] = get_args(hint) or (hint,)
            if not all(isinstance(kind, type) and issubclass(kind, Batch) for kind in kinds):
                like = "a batch type, as in async def write(self, batch: Slips) -> None"
                raise ParameterError(type(self.part).__name__, "the annotation of write", hint, like)
            return kinds
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


def consumers(nodes: Iterable[Node]) -> Mapping[Node, list[Node]]:
    """For each node, those that it feeds."""
    nodes = list(nodes)
    fed: dict[Node, list[Node]] = {node: [] for node in nodes}
    for node in nodes:
        for parent in node.inputs:
            fed.setdefault(parent, []).append(node)
    return fed

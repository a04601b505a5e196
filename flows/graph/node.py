"""Nodes of the graph, and the places of their errors in the files of users."""

import inspect
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, cast, get_args, get_type_hints

from operators.batch import EVERY, Batch
from operators.errors import InputError, ParameterError
from operators.extras import require_extra
from operators.operator import Join, Operator, input_types, output_type
from operators.ports import Description, Sink, Source

FlowPart: TypeAlias = Source[Any] | Operator[Any, Any] | Join[Any, Any, Any] | Sink[Any]


@dataclass(eq=False)
class Node:
    """Source, operator, join or sink, with the nodes that it reads from."""

    name: str  # unique in the flow for sources and sinks; the class name for operators
    part: FlowPart
    inputs: list["Node"] = field(default_factory=list["Node"])

    @property
    def takes(self) -> tuple[type[Batch], ...]:
        """Accepted batch types: one per input of an operator or join, the alternatives of a sink.

        Raises:
            InputError: if an operator does not declare them, or Python cannot find those of a sink.
        """
        if isinstance(self.part, Operator | Join):
            return input_types(type(self.part))
        if isinstance(self.part, Sink):
            kind, base = type(self.part), cast("Any", Sink)
            try:
                hints: dict[str, Any] = get_type_hints(kind.take if kind.write is base.write else kind.write)
            except NameError as error:
                raise InputError(kind.__name__, f"{error}: import it outside `if TYPE_CHECKING`") from error
            hint = hints.get(next(iter(hints), ""))  # of the first parameter
            return get_args(hint) or (cast("Any", hint),)
        return ()

    @property
    def gives(self) -> type[Batch] | None:
        """Batch type of the output; None for a sink.

        Raises:
            InputError: if an operator does not declare it.
            ParameterError: if that of a source is no batch type.
        """
        if isinstance(self.part, Source):
            kind: Any = self.part.kind
            if not (isinstance(kind, type) and issubclass(kind, Batch)):
                must_be = "a batch type: a subclass of Batch with columns"
                raise ParameterError(type(self.part).__name__, "kind", kind, must_be)
            return kind
        return None if isinstance(self.part, Sink) else output_type(type(self.part))

    def describe(self) -> Description:
        """Return the description of a source, with its fingertip if that is known; of other parts, {}."""
        if not isinstance(self.part, Source):
            return {}
        fingertip = self.part.fingertip
        about = self.part.describe()
        return about if fingertip is None else {**about, "fingertip": fingertip.describe()}

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips of the output; streams that belong to all fingertips join each of them."""
        if isinstance(self.part, Source):
            return self.part.fingers
        found = {finger for parent in self.inputs for finger in parent.fingers}
        return tuple(sorted(found - {EVERY})) or (EVERY,)


def check_extras(nodes: Iterable[Node]) -> None:
    """Require the extras that sources and sinks need."""
    for node in nodes:
        if isinstance(node.part, Source | Sink) and node.part.extra:
            require_extra(node.part.extra, node.name)


def consumers(nodes: Iterable[Node]) -> Mapping[Node, list[Node]]:
    """Return the nodes that read from each node."""
    nodes = list(nodes)
    fed: dict[Node, list[Node]] = {node: [] for node in nodes}
    for node in nodes:
        for parent in node.inputs:
            fed[parent].append(node)
    return fed


def location(part: object, error: BaseException) -> str:
    """Return the last line of a part's file that an error passed through, such as `` (own.py:23)``."""
    try:
        file = Path(inspect.getfile(type(part)))
    except (TypeError, OSError):
        return ""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == file.resolve()]
    return f" ({file.name}:{lines[-1]})" if lines else ""

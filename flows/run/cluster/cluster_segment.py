"""The part of a flow that runs on the cluster by fingertip: from its sources to what its operators give."""

from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

from flows.graph import Flow
from flows.graph.node import Node
from operators.batch import Batch
from operators.errors import FlowError
from operators.ports import Clock, Run, Sink, Source
from storage import Dataset

_TAP: Final = "tap-"


class Claimed(Source[Batch]):
    """Stands for a source whose rows the claims name.

    Args:
        kind: The type of its batches.
        fingers: The fingertips that they belong to.
    """

    def __init__(self, kind: type[Batch], fingers: tuple[int, ...]) -> None:
        self._kind, self._fingers = kind, fingers

    @property
    def kind(self) -> type[Batch]:
        """The type of its batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertips that they belong to."""
        return self._fingers

    async def batches(self, clock: Clock) -> AsyncIterator[Batch]:  # noqa: ARG002 - as all sources have it
        """Give nothing: claims are pushed."""
        nothing: tuple[Batch, ...] = ()
        for batch in nothing:
            yield batch


@dataclass(eq=False)
class Tap(Sink[Batch]):
    """Stands behind an operator whose rows a dataset is to take."""

    operator: int  # its place among the flow's nodes

    @property
    def destination(self) -> str:
        """Its own."""
        return f"{_TAP}{self.operator}"

    async def open(self, run: Run) -> None:
        """Do nothing: what it takes is staged."""

    async def write(self, batch: Batch) -> None:
        """Do nothing: what it takes is staged."""


def check_flow(flow: Flow) -> None:
    """Raise what keeps a flow from a cluster, if anything does.

    Raises:
        FlowError: if it has a sink other than a dataset, or no operator whose rows a dataset takes.
    """
    for node in flow.sinks():
        if not isinstance(node.part, Dataset):
            reason = (
                "a cluster writes datasets only: leave this sink out, or set the flow so that it has none"
            )
            raise FlowError(flow.name, node.name, reason)
    if not tapped(flow):
        raise FlowError(
            flow.name, "datasets", "they take nothing that is derived: there is nothing to work on"
        )


def tapped(flow: Flow) -> list[Node]:
    """The operators whose rows sinks take, in the order of the flow."""
    taken = {parent for node in flow.sinks() for parent in node.inputs}
    return [node for node in flow.nodes if node in taken and not isinstance(node.part, Source)]


def segment(flow: Flow, fingers: Mapping[str, tuple[int, ...]]) -> Flow:
    """The same operators between stand-ins: what each of `tapped` gives goes to a `Tap` of its own.

    Args:
        flow: The flow; it stays as it is.
        fingers: The fingertips of each source, by the name of its node.
    """
    part = Flow(flow.name)
    copies: dict[Node, Node] = {}

    def copied(node: Node) -> Node:
        if node not in copies:
            inputs = [copied(parent) for parent in node.inputs]
            stand_in: Any = node.part
            if isinstance(stand_in, Source):
                stand_in = Claimed(cast("type[Batch]", node.gives), fingers[node.name])
            copies[node] = Node(node.name, stand_in, inputs)
            part.nodes.append(copies[node])
        return copies[node]

    for node in tapped(flow):
        place = flow.nodes.index(node)
        tap = Node(f"{_TAP}{place}", Tap(place), [copied(node)])
        part.nodes.append(tap)
    return part


def needed(flow: Flow) -> set[str]:
    """The names of the sources that feed what is tapped."""
    found, rest = set[str](), list(tapped(flow))
    while rest:
        node = rest.pop()
        rest += node.inputs
        if isinstance(node.part, Source):
            found.add(node.name)
    return found

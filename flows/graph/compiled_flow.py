"""What a runner carries out: a flow compiled into one fresh operator per fingertip, in order of flow."""

import pickle
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

from flows.graph.flow import Flow
from flows.graph.node import Node
from flows.graph.validation import validate
from operators.batch import EVERY, Batch, concat
from operators.errors import BatchError, OperatorError, SlipflowError
from operators.operator import Join, Operator
from operators.ports import Sink

Entry: TypeAlias = tuple[Node, int]  # a source's node and the fingertip of a batch
Delivery: TypeAlias = tuple[Node, Batch]  # a sink's node and what it is to take


@dataclass(eq=False)
class _Stage:
    """One node for one fingertip: where it reads and writes among the values of a push."""

    index: int
    node: Node
    finger: int
    inputs: tuple[int, ...]
    operator: Operator[Any, Any] | Join[Any, Any, Any] | None  # None for a source
    takes: tuple[type[Batch], ...]
    gives: type[Batch]
    sinks: list[Node] = field(default_factory=list[Node])
    _push: Callable[..., Batch] = field(init=False)
    _nothing: tuple[Batch, ...] = field(init=False)
    _first: int = field(init=False)
    _second: int | None = field(init=False)  # None: an operator, not a join

    def __post_init__(self) -> None:
        if self.operator is not None:
            self._push = self.operator.push
            self._first, *second = self.inputs
            self._second = second[0] if second else None
        self._nothing = tuple(kind.empty() for kind in self.takes)

    def push(self, values: Sequence[Batch | None]) -> Batch | None:
        """The output for what the inputs have, or None if they have nothing or nothing came of it."""
        left = values[self._first]
        if self._second is None:
            if left is None:
                return None
            out = self._push(left)
        else:
            right = values[self._second]
            if left is None and right is None:
                return None
            nothing = self._nothing
            out = self._push(nothing[0] if left is None else left, nothing[1] if right is None else right)
        if type(out) is self.gives and out.finger == self.finger and out.time.size:
            return out
        return self.checked(out)

    def resume(self, operator: Operator[Any, Any] | Join[Any, Any, Any]) -> None:
        """Go on with an operator in this state."""
        self.operator, self._push = operator, operator.push

    def checked(self, out: Batch) -> Batch | None:
        """What the operator gave, if it is what it declares to give; None if it is nothing."""
        if type(out) is not self.gives and not isinstance(out, self.gives):
            raise TypeError(f"gave {type(out).__name__}, and declares to give {self.gives.__name__}")
        if not out.time.size:
            return None
        if out.finger != self.finger:
            raise ValueError(
                f"gave rows of fingertip {out.finger}, not {self.finger}: pass finger=batch.finger on"
            )
        return out


class CompiledFlow:
    """The state of one run of a flow: push batches in at its sources, get what its sinks are to take.

    >>> import numpy as np
    >>> from flows.graph.testing import TestSink, TestSource
    >>> from operators import Debounce, Scores
    >>> flow = Flow("felt")
    >>> (flow.source(TestSource(Scores)) | Debounce()).to(TestSink())
    >>> plan = CompiledFlow(flow)
    >>> scores = Scores(np.arange(4), np.array([0.1, 0.9, 0.9, 0.9]))
    >>> [(sink, slips)] = plan.push({plan.entries[0]: scores})
    >>> sink.name, slips.time, slips.start
    ('testsink', array([2]), array([1]))

    Args:
        flow: what is to be carried out.
        only: the fingertips to do it for, with all that belongs to every one; None: for all of them.

    Attributes:
        sink_types: By the place of each sink, the types of the batches that it may be given.

    Raises:
        FlowError: if the flow is wired wrongly.
    """

    def __init__(self, flow: Flow, only: Collection[int] | None = None) -> None:
        validate(flow)
        self._flow = flow.name
        self._stages: list[_Stage] = []
        self._stage_of: dict[Entry, int] = {}
        fingers = {
            node: [each for each in node.fingers if only is None or each in (*only, EVERY)]
            for node in flow.nodes
        }
        for node in _in_order(flow):
            if isinstance(node.part, Sink):
                for parent in node.inputs:
                    for finger in fingers[parent]:
                        self._stages[self._stage_of[parent, finger]].sinks.append(node)
            else:
                for finger in fingers[node]:
                    self._compile(node, finger)
        self.entries = [(node, finger) for node in flow.sources() for finger in fingers[node]]
        self.sink_types = {
            node.part.destination: tuple(cast("type[Batch]", parent.gives) for parent in node.inputs)
            for node in flow.nodes
            if isinstance(node.part, Sink)
        }
        self._all = [stage for stage in self._stages if stage.operator is not None]
        places = {entry: self._stage_of[entry] for entry in self.entries}
        self._entered = {
            entry: (self._stages[place], self._reached_from(place)) for entry, place in places.items()
        }

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        """Carry batches that arrived together through the flow.

        Args:
            batches: by source and fingertip; more than one only if all are slices of one span of time.

        Returns:
            What the sinks are to take, in order.

        Raises:
            BatchError: if an operator gives something else than it declares.
        """
        values: list[Batch | None] = [None] * len(self._stages)
        deliveries: list[Delivery] = []
        behind = self._all
        for entry, batch in batches.items():
            try:
                stage, downstream = self._entered[entry]
            except KeyError:
                node, finger = entry
                reason = f"source {node.name!r} gave fingertip {finger}, and declares {node.fingers}"
                raise BatchError(type(batch).__name__, "finger", reason) from None
            if batch.time.size:
                values[stage.index] = batch
                deliveries += [(sink, batch) for sink in stage.sinks]
            if len(batches) == 1:
                behind = downstream
        for stage in behind:
            try:
                out = stage.push(values)
            except Exception as error:
                raise self._failure(stage, error) from error
            if out is not None:
                values[stage.index] = out
                if stage.sinks:
                    deliveries += [(sink, out) for sink in stage.sinks]
        return deliveries

    def flush(self) -> list[Delivery]:
        """What the end of all streams completes, in order."""
        values: list[Batch | None] = [None] * len(self._stages)
        deliveries: list[Delivery] = []
        for stage in self._all:
            try:
                pushed = stage.push(values)
                last = stage.checked(cast("Operator[Any, Any]", stage.operator).flush())
            except Exception as error:
                raise self._failure(stage, error) from error
            out = concat(stage.gives, [batch for batch in (pushed, last) if batch is not None])
            if len(out):
                values[stage.index] = out
                deliveries += [(sink, out) for sink in stage.sinks]
        return deliveries

    def snapshot(self) -> bytes:
        """What all operators remember: `restore` goes on from it, in another process too.

        Raises:
            OperatorError: if an operator's state does not pickle.
        """
        states = list[bytes]()
        for stage in self._all:
            try:
                states.append(pickle.dumps(stage.operator, pickle.HIGHEST_PROTOCOL))
            except (pickle.PicklingError, AttributeError, TypeError) as error:
                raise self._failure(stage, error) from error
        return pickle.dumps(states, pickle.HIGHEST_PROTOCOL)

    def restore(self, snapshot: bytes) -> None:
        """Go on from a snapshot of a plan of the same flow; it is a pickle: restore only what is your own."""
        for stage, state in zip(self._all, pickle.loads(snapshot), strict=True):  # noqa: S301 - our own
            stage.resume(pickle.loads(state))  # noqa: S301 - the same

    def _failure(self, stage: _Stage, error: Exception) -> OperatorError:
        reason = str(error) if isinstance(error, SlipflowError) else f"{type(error).__name__}: {error}"
        return OperatorError(self._flow, stage.node.name, reason)

    def _compile(self, node: Node, finger: int) -> None:
        inputs = tuple(
            self._stage_of[parent, finger if finger in parent.fingers else EVERY] for parent in node.inputs
        )
        operator = node.part.reset_copy() if isinstance(node.part, Operator | Join) else None
        kind = cast("type[Batch]", node.gives)
        self._stage_of[node, finger] = len(self._stages)
        self._stages.append(_Stage(len(self._stages), node, finger, inputs, operator, node.takes, kind))

    def _reached_from(self, index: int) -> list[_Stage]:
        reached, stages = {index}, list[_Stage]()
        for stage in self._all:
            if reached.intersection(stage.inputs):
                reached.add(stage.index)
                stages.append(stage)
        return stages


def _in_order(flow: Flow) -> list[Node]:
    ordered: dict[Node, None] = {}

    def visit(node: Node) -> None:
        if node not in ordered:
            for parent in node.inputs:
                visit(parent)
            ordered[node] = None

    for node in flow.nodes:
        visit(node)
    return list(ordered)

"""Compilation of a flow: one new operator per node and fingertip, in the order of declaration."""

import pickle
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

from flows.graph.error_location import location
from flows.graph.flow import Flow
from flows.graph.node import Node
from flows.graph.validation import validate
from operators.batch import EVERY, Batch, concat
from operators.errors import BatchError, OperatorError, SlipflowError
from operators.operator import Join, Operator
from operators.ports import Sink, Source

Entry: TypeAlias = tuple[Node, int]  # a source's node and a fingertip
Delivery: TypeAlias = tuple[Node, Batch]  # a sink's node and a batch for it


@dataclass(eq=False)
class Stage:
    """One node for one fingertip; `index` is the position of its output among the values of a push."""

    index: int
    node: Node
    finger: int
    inputs: tuple[int, ...]
    operator: Operator[Any, Any] | Join[Any, Any, Any] | None  # None for a source
    takes: tuple[type[Batch], ...]
    gives: type[Batch]
    ordered: bool  # all inputs come from operators of slipflow, so no row is late
    sinks: list[Node] = field(default_factory=list[Node])
    tested: bool = field(init=False)  # an operator of slipflow: its tests check the output
    _push: Callable[..., Batch] = field(init=False)
    _empty: tuple[Batch, ...] = field(init=False)
    _first: int = field(init=False)
    _second: int | None = field(init=False)  # None: an operator, not a join

    def __post_init__(self) -> None:
        if self.operator is not None:
            self.resume(self.operator)
            self._first, *second = self.inputs
            self._second = second[0] if second else None
        self._empty = tuple(kind.empty() for kind in self.takes)
        self.tested = type(self.operator).__module__.startswith("operators.")

    def push(self, values: Sequence[Batch | None]) -> Batch | None:
        """Run the operator on its inputs; return None if there is no input or no output."""
        left = values[self._first]
        if self._second is None:
            if left is None:
                return None
            out = self._push(left)
        else:
            right = values[self._second]
            if left is None and right is None:
                return None
            empty = self._empty
            out = self._push(empty[0] if left is None else left, empty[1] if right is None else right)
        if self.tested:
            return out if out.time.size else None
        return self.checked(out)

    def resume(self, operator: Operator[Any, Any] | Join[Any, Any, Any]) -> None:
        """Set the operator, or replace it by a restored one."""
        self.operator, self._push = operator, operator.process if self.ordered else operator.push

    def checked(self, out: Batch) -> Batch | None:
        """Return the output, or None if it is empty; check its type, columns, fingertip and order."""
        if type(out) is not self.gives and not isinstance(out, self.gives):
            raise TypeError(f"returned {type(out).__name__}, but declares {self.gives.__name__}")
        if not out.check().time.size:
            return None
        if out.finger != self.finger:
            raise ValueError(
                f"returned rows of fingertip {out.finger}, not {self.finger}: pass on finger=batch.finger"
            )
        return out if out.time.size == 1 else out.check_order()


class CompiledFlow:
    """Operators and their state for one run of a flow.

    >>> import numpy as np
    >>> from flows.graph.testing import TestSink, TestSource
    >>> from operators import Debounce, Scores
    >>> flow = Flow("events")
    >>> (flow.source(TestSource(Scores)) | Debounce()).to(TestSink())
    >>> compiled = CompiledFlow(flow)
    >>> scores = Scores(np.arange(4), np.array([0.1, 0.9, 0.9, 0.9]))
    >>> [(sink, slips)] = compiled.push({compiled.entries[0]: scores})
    >>> sink.name, slips.time, slips.start
    ('testsink', array([2]), array([1]))

    Args:
        flow: Declaration to compile.
        only: Fingertips to compile for, with the streams that belong to all fingertips; None: all fingertips.
        operators: Operators and joins to compile, with all that they read from; None: all.

    Attributes:
        entries: Source nodes with their fingertips.
        operator_stages: Operators and joins, one per fingertip, in the order of declaration.
        sink_types: Batch types that each sink can receive, by its destination.

    Raises:
        FlowError: if the flow is wired wrongly.
    """

    def __init__(
        self, flow: Flow, only: Collection[int] | None = None, operators: Collection[Node] | None = None
    ) -> None:
        validate(flow)
        self._flow = flow.name
        self._stages: list[Stage] = []
        self._stage_of: dict[Entry, int] = {}  # of each node and fingertip
        fingers = {
            node: [each for each in node.fingers if only is None or each in (*only, EVERY)]
            for node in flow.nodes
            if operators is None or node in operators or isinstance(node.part, Source)
        }
        for node in flow.nodes:  # declared after its inputs, unless it is a sink
            if not isinstance(node.part, Sink):
                for finger in fingers.get(node, ()):
                    self._add_stage(node, finger)
        for node in flow.sinks():
            for parent in node.inputs:
                for finger in fingers.get(parent, ()):
                    self._stages[self._stage_of[parent, finger]].sinks.append(node)
        self.entries = [(node, finger) for node in flow.sources() for finger in fingers[node]]
        self.sink_types = {
            node.part.destination: tuple(cast("type[Batch]", parent.gives) for parent in node.inputs)
            for node in flow.nodes
            if isinstance(node.part, Sink)
        }
        self.operator_stages = [stage for stage in self._stages if stage.operator is not None]
        indices = {entry: self._stage_of[entry] for entry in self.entries}
        self._entered = {
            entry: (self._stages[index], self._downstream(index)) for entry, index in indices.items()
        }

    def stage(self, entry: Entry) -> Stage:
        """Return the stage of a source and fingertip."""
        return self._entered[entry][0]

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        """Run the operators on batches that arrived together, and return the batches for the sinks, in order.

        Args:
            batches: Batches by source and fingertip; several must be slices of one time span.

        Raises:
            BatchError: if a source yields a fingertip that it does not declare.
            OperatorError: if an operator fails or returns another type than it declares.
        """
        return [(sink, batch) for stage, batch in self.outputs(batches) for sink in stage.sinks]

    def flush(self) -> list[Delivery]:
        """End all streams, and return the last batches for the sinks, in order."""
        return [(sink, batch) for stage, batch in self.last_outputs() for sink in stage.sinks]

    def outputs(self, batches: Mapping[Entry, Batch]) -> list[tuple[Stage, Batch]]:
        """Push batches as `push` does, and return the output of each stage, including sources.

        Raises:
            BatchError: if a source yields a fingertip that it does not declare.
            OperatorError: if an operator fails or returns another type than it declares.
        """
        values: list[Batch | None] = [None] * len(self._stages)
        outputs: list[tuple[Stage, Batch]] = []
        stages = self.operator_stages
        for entry, batch in batches.items():
            try:
                stage, downstream = self._entered[entry]
            except KeyError:
                node, finger = entry
                reason = f"source {node.name!r} yielded fingertip {finger}, but declares {node.fingers}"
                raise BatchError(type(batch).__name__, "finger", reason) from None
            if batch.time.size:
                values[stage.index] = batch
                outputs.append((stage, batch))
            if len(batches) == 1:
                stages = downstream
        for stage in stages:
            try:
                out = stage.push(values)
            except Exception as error:
                raise self._failure(stage, error) from error
            if out is not None:
                values[stage.index] = out
                outputs.append((stage, out))
        return outputs

    def last_outputs(self) -> list[tuple[Stage, Batch]]:
        """End all streams as `flush` does, and return the last output of each operator."""
        values: list[Batch | None] = [None] * len(self._stages)
        outputs: list[tuple[Stage, Batch]] = []
        for stage in self.operator_stages:
            try:
                pushed = stage.push(values)
                last = stage.checked(cast("Operator[Any, Any]", stage.operator).flush())
            except Exception as error:
                raise self._failure(stage, error) from error
            out = concat(stage.gives, [batch for batch in (pushed, last) if batch is not None])
            if len(out):
                values[stage.index] = out
                outputs.append((stage, out))
        return outputs

    def snapshot(self) -> bytes:
        """Pickle the state of all operators, for `restore` in this or another process.

        Raises:
            OperatorError: if an operator's state does not pickle.
        """
        operators = [stage.operator for stage in self.operator_stages]
        try:
            return pickle.dumps(operators, pickle.HIGHEST_PROTOCOL)  # what they share is in it once
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise self._failure(next(filter(_fails_to_pickle, self.operator_stages)), error) from error

    def restore(self, snapshot: bytes) -> None:
        """Restore the state from a snapshot of the same flow; it is a pickle, so load only trusted ones."""
        for stage, operator in zip(self.operator_stages, pickle.loads(snapshot), strict=True):  # noqa: S301 - our own
            stage.resume(operator)

    def _failure(self, stage: Stage, error: Exception) -> OperatorError:
        reason = str(error)
        if not isinstance(error, SlipflowError):
            reason = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
        reason += "" if stage.tested else location(stage.operator, error)
        return OperatorError(self._flow, stage.node.name, reason)

    def _add_stage(self, node: Node, finger: int) -> None:
        inputs = tuple(
            self._stage_of[parent, finger if finger in parent.fingers else EVERY] for parent in node.inputs
        )
        operator = node.part.reset_copy() if isinstance(node.part, Operator | Join) else None
        if operator is not None:
            operator.prepare()
        kind = cast("type[Batch]", node.gives)
        ordered = all(self._stages[index].tested for index in inputs)
        self._stage_of[node, finger] = len(self._stages)
        self._stages.append(
            Stage(len(self._stages), node, finger, inputs, operator, node.takes, kind, ordered)
        )

    def _downstream(self, index: int) -> list[Stage]:
        reached, stages = {index}, list[Stage]()
        for stage in self.operator_stages:
            if reached.intersection(stage.inputs):
                reached.add(stage.index)
                stages.append(stage)
        return stages


def _fails_to_pickle(stage: Stage) -> bool:
    try:
        pickle.dumps(stage.operator, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError):
        return True
    return False

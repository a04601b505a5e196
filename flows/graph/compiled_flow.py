"""Compilation of a flow: one new operator per node and fingertip, in the order of declaration."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

from flows.graph.flow import Flow
from flows.graph.node import Node, location
from flows.graph.validation import sink_fingertips, validate
from operators.batch import EVERY, Batch, concat
from operators.errors import BatchError, OperatorError, SlipflowError
from operators.operator import Join, LateRowFilter, Operator, output_type
from operators.ports import Source

Entry: TypeAlias = tuple[Node, int]  # a source's node and a fingertip
Values: TypeAlias = Mapping[int, Batch]  # batches of sources and operators in one push
Delivery: TypeAlias = tuple[Node, Batch]  # a node and a batch of its output, for the sinks that read from it


@dataclass(eq=False)
class Stage:
    """Operator or join for one fingertip; `index` is the key of its output among the values of a push."""

    index: int
    node: Node
    finger: int
    inputs: tuple[int, ...]
    operator: Operator[Any, Any] | Join[Any, Any, Any]
    delivers: bool  # sinks read from it
    gives: type[Batch] = field(init=False)
    tested: bool = field(init=False)
    _process: Callable[..., Batch] = field(init=False)
    _empty: tuple[Batch, ...] = field(init=False)
    _first: int = field(init=False)
    _second: int | None = field(init=False)  # None: an operator, not a join

    def __post_init__(self) -> None:
        self.tested = _is_tested(self.node)
        self.gives = output_type(type(self.operator))
        self._empty = tuple(kind.empty() for kind in self.node.takes)
        self._first, *second = self.inputs
        self._second = second[0] if second else None
        ordered = all(isinstance(parent.part, Source) or _is_tested(parent) for parent in self.node.inputs)
        process: Callable[..., Batch] = self.operator.process if ordered else self.operator.push
        self._process = process if self.tested else lambda *inputs: self.checked(process(*inputs))

    def push(self, values: Values) -> Batch | None:
        """Run the operator on its inputs; return None if there is no input or no output."""
        left = values.get(self._first)
        if self._second is None:
            if left is None:
                return None
            out = self._process(left)
        else:
            right = values.get(self._second)
            if left is None:
                if right is None:
                    return None
                left = self._empty[0]
            out = self._process(left, self._empty[1] if right is None else right)
        return out if out.time.size else None

    def flush(self, values: Values) -> Batch | None:
        """Run the operator on its last inputs and end it; return None if there is no output."""
        pushed, last = self.push(values), self.checked(self.operator.flush())
        out = concat(self.gives, [last] if pushed is None else [pushed, last])
        return out if out.time.size else None

    def checked(self, out: Batch) -> Batch:
        """Return the output after a check of its type, columns, fingertip and order."""
        if not isinstance(out, self.gives):
            raise TypeError(f"returned {type(out).__name__}, but declares {self.gives.__name__}")
        if out.check().time.size and out.finger != self.finger:
            raise ValueError(
                f"returned rows of fingertip {out.finger}, not {self.finger}: pass on finger=batch.finger"
            )
        return out.check_order()


@dataclass(eq=False)
class _Entrance:
    """Start of the path of a source's rows; `index` is the key of these rows among the values of a push."""

    index: int
    delivers: bool  # sinks read from the source
    downstream: list[Stage]
    late_filter: LateRowFilter = field(default_factory=LateRowFilter)


class CompiledFlow:
    """Operators and their state for one run of a flow.

    >>> import numpy as np
    >>> from flows.graph.testing import TestSink, TestSource
    >>> from operators import Debounce, Scores
    >>> flow = Flow("events")
    >>> (flow.source(TestSource(Scores)) | Debounce()).to(TestSink())
    >>> compiled = CompiledFlow(flow)
    >>> scores = Scores(np.arange(4), np.array([0.1, 0.9, 0.9, 0.9]))
    >>> [(node, slips)] = compiled.push({compiled.entries[0]: scores})
    >>> node.name, slips.time, slips.start
    ('Debounce', array([2]), array([1]))

    Args:
        flow: Declaration to compile.

    Attributes:
        entries: Source nodes with their fingertips.
        stages: Operators and joins, one per fingertip, in the order of declaration.
        sink_types: Batch types that each sink can receive with their fingertips, by its destination.
        fingertips: Fingertips of the touch streams of each sink, by its destination and their type.

    Raises:
        FlowError: if the flow is wired wrongly.
        OperatorError: if an operator cannot be copied or prepared.
    """

    def __init__(self, flow: Flow) -> None:
        validate(flow)
        Batch.zeros(2).check_order()  # loads compiled code, as `prepare` of the operators
        self._flow = flow.name
        self.entries = [(node, finger) for node in flow.sources() for finger in node.fingers]
        self._indices = {entry: index for index, entry in enumerate(self.entries)}
        read = {parent for sink in flow.sinks() for parent in sink.inputs}  # nodes that sinks read from
        self.stages = [  # declared after their inputs
            self._stage(node, finger, delivers=node in read)
            for node in flow.nodes
            if isinstance(node.part, Operator | Join)
            for finger in node.fingers
        ]
        self._entrances = {
            entry: _Entrance(index, entry[0] in read, self._downstream(index))
            for index, entry in enumerate(self.entries)
        }
        self.fingertips = sink_fingertips(flow)
        self.sink_types = {
            sink.destination: {
                cast("type[Batch]", parent.gives): tuple(
                    sorted(
                        {each for same in node.inputs if same.gives is parent.gives for each in same.fingers}
                    )
                )
                for parent in node.inputs
            }
            for node, sink in flow.sinks().items()
        }

    @property
    def late_filters(self) -> dict[Entry, LateRowFilter]:
        """Filters of late rows, by source and fingertip."""
        return {entry: entrance.late_filter for entry, entrance in self._entrances.items()}

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        """Run the operators on batches that arrived together, and return the batches for sinks, in order.

        Operators receive no late rows; sinks that read from a source do.

        Args:
            batches: Batches by source and fingertip; several must be slices of one time span.

        Raises:
            BatchError: if a source yields a fingertip that it does not declare.
            OperatorError: if an operator fails or returns a type that it does not declare.
        """
        values: dict[int, Batch] = {}
        deliveries: list[Delivery] = []
        stages = self.stages
        for entry, batch in batches.items():
            try:
                entrance = self._entrances[entry]
            except KeyError:
                node, finger = entry
                reason = f"source {node.name!r} yielded fingertip {finger}, but declares {node.fingers}"
                raise BatchError(type(batch).__name__, "finger", reason) from None
            if len(batches) == 1:
                stages = entrance.downstream
            if batch.time.size:
                if entrance.delivers:
                    deliveries.append((entry[0], batch))
                if (kept := entrance.late_filter.filter(batch)).time.size:
                    values[entrance.index] = kept
        return self._run(stages, Stage.push, values, deliveries)

    def flush(self) -> list[Delivery]:
        """End all streams, and return the last batches for sinks, in order."""
        return self._run(self.stages, Stage.flush, {}, [])

    def _run(
        self,
        stages: Sequence[Stage],
        step: Callable[[Stage, Values], Batch | None],
        values: dict[int, Batch],
        deliveries: list[Delivery],
    ) -> list[Delivery]:
        """Run a step of each stage, and add its output to the values and deliveries."""
        for stage in stages:
            try:
                out = step(stage, values)
            except Exception as error:
                raise self._failure(stage.node, error) from error
            if out is not None:
                values[stage.index] = out
                if stage.delivers:
                    deliveries.append((stage.node, out))
        return deliveries

    def _failure(self, node: Node, error: Exception) -> OperatorError:
        reason = str(error)
        if not isinstance(error, SlipflowError):
            reason = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
        reason += "" if _is_tested(node) else location(node.part, error)
        return OperatorError(self._flow, node.name, reason)

    def _stage(self, node: Node, finger: int, *, delivers: bool) -> Stage:
        inputs = tuple(
            self._indices[parent, finger if finger in parent.fingers else EVERY] for parent in node.inputs
        )
        index = self._indices[node, finger] = len(self._indices)
        try:
            operator = cast("Operator[Any, Any] | Join[Any, Any, Any]", node.part).reset_copy()
            operator.prepare()
        except SlipflowError:
            raise
        except Exception as error:
            raise self._failure(node, error) from error
        return Stage(index, node, finger, inputs, operator, delivers)

    def _downstream(self, index: int) -> list[Stage]:
        reached, stages = {index}, list[Stage]()
        for stage in self.stages:
            if reached.intersection(stage.inputs):
                reached.add(stage.index)
                stages.append(stage)
        return stages


def _is_tested(node: Node) -> bool:
    """Return True for an operator of slipflow, whose tests check its output."""
    return type(node.part).__module__.startswith("operators.")

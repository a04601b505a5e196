"""Compilation of a flow: operators that consist of steps are fused; others run on batches between them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, cast

import numpy as np

from flows.graph.flow import Flow
from flows.graph.node import Node, location
from flows.graph.validation import sink_fingertips, trace_fingertips, validate
from operators.batch import BAROMETERS, EVERY, Batch, concat, ms
from operators.errors import BatchError, OperatorError, SlipflowError
from operators.operator import Join, Operator, fuses, require_process
from operators.ports import Source
from operators.score import Score
from operators.segment import EARLIEST, Segment, Stage, compiler
from operators.steps import RowType, Steps

Entry: TypeAlias = tuple[Node, int]  # a source's node and a fingertip
Values: TypeAlias = dict[Entry, Batch]  # batches of sources and operators in one push, by node and fingertip
Delivery: TypeAlias = tuple[Node, Batch]  # a node and a batch of its output, for the sinks that read from it
Push: TypeAlias = Callable[..., list[Delivery]]
SomeOperator: TypeAlias = Operator[Any, Any] | Join[Any, Any, Any]


class _Fused:
    """Operators that run as one segment, for all their fingertips."""

    def __init__(self, nodes: Mapping[Node, Steps], types: Mapping[Node, RowType], read: set[Node]) -> None:
        self.nodes = list(nodes)  # each after its inputs
        self.entrances = list(dict.fromkeys(p for node in nodes for p in node.inputs if p not in nodes))
        places = {node: place for place, node in enumerate([*self.entrances, *self.nodes])}
        stages = [
            Stage(steps, types[node], tuple(places[parent] for parent in node.inputs), node in read, node)
            for node, steps in nodes.items()
        ]
        self.fingers, given = self.nodes[0].fingers, [types[node] for node in self.entrances]
        self.segments = {finger: Segment(given, stages, finger) for finger in self.fingers}

    def push(self, values: Values) -> list[Delivery]:
        """Run the operators on their inputs; return the output of each node and fingertip."""
        common, deliveries = self._present(values, EVERY), list[Delivery]()
        for finger, segment in self.segments.items():
            if batches := common | self._present(values, finger):
                deliveries += segment.pusher(*batches)(*batches.values())
        return deliveries

    def flush(self, values: Values) -> list[Delivery]:
        """Run the operators on their last inputs and end their streams."""
        return [*self.push(values), *(out for each in self.segments.values() for out in each.flush())]

    def _present(self, values: Values, finger: int) -> dict[int, Batch]:
        return {i: values[node, finger] for i, node in enumerate(self.entrances) if (node, finger) in values}


class _Single:
    """Operator or join with a `process` of its own, for one fingertip."""

    def __init__(self, node: Node, operator: SomeOperator, finger: int, given: list[RowType]) -> None:
        self.nodes, self.entrances, self._operator = [node], node.inputs, operator
        self._finger, self._gives = finger, cast("type[Batch]", node.gives)
        self._newest = EARLIEST  # ns, time of the last output row
        self._keys = [(parent, finger if finger in parent.fingers else EVERY) for parent in node.inputs]
        streams = zip(given, self._keys, strict=True)
        self._empty = [each.kind.unpack(np.empty(0, each.packed), of) for each, (_, of) in streams]

    def push(self, values: Values) -> list[Delivery]:
        """Run the operator on its inputs."""
        if not any(key in values for key in self._keys):
            return []
        inputs = [values.get(key, empty) for key, empty in zip(self._keys, self._empty, strict=True)]
        return self._checked(cast("Any", self._operator).push(*inputs))

    def flush(self, values: Values) -> list[Delivery]:
        """Run the operator on its last inputs and end it."""
        return [*self.push(values), *self._checked(self._operator.flush())]

    def _checked(self, out: Batch) -> list[Delivery]:
        """Return the output, if there is any, after a check of its type, columns, fingertip and order."""
        if not isinstance(out, self._gives):
            raise TypeError(f"returned {type(out).__name__}, but declares {self._gives.__name__}")
        if not out.check().time.size:
            return []
        if out.finger != self._finger:
            raise ValueError(
                f"returned rows of fingertip {out.finger}, not {self._finger}: pass on finger=batch.finger"
            )
        first, before, self._newest = out.check_order().time.item(0), self._newest, out.time.item(-1)
        if first < before:
            reason = f"decreases by {(before - first) / ms:g} ms between two batches, must be in order"
            raise BatchError(type(out).__name__, "time", f"{reason}: hold early rows back")
        return [(self.nodes[0], out)]


class CompiledFlow:
    """Operators and their state for one run of a flow.

    >>> import numpy as np
    >>> from flows.graph.testing import TestSink, TestSource
    >>> from operators import Debounce, Scores
    >>> flow = Flow("events")
    >>> _ = (flow.source(TestSource(Scores)) | Debounce()).to(TestSink())
    >>> compiled = CompiledFlow(flow)
    >>> scores = Scores(np.arange(4), np.array([0.1, 0.9, 0.9, 0.9]))
    >>> [(node, slips)] = compiled.push({compiled.entries[0]: scores})
    >>> node.name, slips.time, slips.start
    ('Debounce', array([2]), array([1]))

    Args:
        flow: Declaration to compile, whose sources are prepared.

    Attributes:
        entries: Source nodes with their fingertips.
        sink_types: Batch types that each sink can receive with their fingertips, by its destination.
        fingertips: Fingertips of the touch streams of each sink, by its destination and their type.

    Raises:
        FlowError: if the flow is wired wrongly.
        OperatorError: if an operator cannot be copied, prepared or compiled.
    """

    def __init__(self, flow: Flow) -> None:
        validate(flow)
        self._flow = flow.name
        self.entries = [(node, finger) for node in flow.sources() for finger in node.fingers]
        self._read = {parent for sink in flow.sinks() for parent in sink.inputs}  # nodes that sinks read from
        self._units = self._compiled(flow)
        for source in flow.sources().values():
            source.prepare()
        self._pushers = dict[tuple[Entry, ...], Push]()
        self.fingertips = sink_fingertips(flow)
        self.sink_types = {
            sink.destination: {cast("type[Batch]", each.gives): _fingers(node, each) for each in node.inputs}
            for node, sink in flow.sinks().items()
        }

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        """Run the operators on batches that arrived together, and return the batches for sinks, in order.

        Operators receive no late rows; sinks that read from a source do.

        Args:
            batches: Batches by source and fingertip; several must be slices of one time span.

        Raises:
            BatchError: if a source yields a fingertip that it does not declare.
            OperatorError: if an operator fails or returns a type that it does not declare.
        """
        entries = tuple(batches)
        if (push := self._pushers.get(entries)) is None:
            push = self._pushers[entries] = self.pusher(*entries)
        return push(*batches.values())

    def pusher(self, *entries: Entry) -> Push:
        """Return the function that `push` calls with the batches of these sources and fingertips.

        Raises:
            BatchError: if a source does not declare the fingertip.
        """
        for node, finger in entries:
            if (node, finger) not in self.entries:
                reason = f"source {node.name!r} yielded fingertip {finger}, but declares {node.fingers}"
                raise BatchError(cast("type[Batch]", node.gives).__name__, "finger", reason)
        units = self._reached({node for node, _ in entries})
        read = [(i, node) for i, (node, _) in enumerate(entries) if node in self._read]
        if len(units) == 1 and isinstance(unit := units[0], _Fused):
            fingers = {finger for _, finger in entries} if len(unit.fingers) > 1 else set(unit.fingers)
            places = [unit.entrances.index(node) if node in unit.entrances else -1 for node, _ in entries]
            if -1 not in places and len(fingers) == 1:
                chosen = [segment for each, segment in unit.segments.items() if fingers & {each, EVERY}]
                return self._direct(read, unit.nodes, *(segment.pusher(*places) for segment in chosen))
        if not units:
            return lambda *batches: [(node, batches[i]) for i, node in read]

        def push_all(*batches: Batch) -> list[Delivery]:
            values = {entry: batch for entry, batch in zip(entries, batches, strict=True) if batch.time.size}
            deliveries = [(node, batches[i]) for i, node in read if batches[i].time.size]
            for unit in units:
                self._run(unit, unit.push, values, deliveries)
            return deliveries

        return _by_instant(push_all) if any(map(_merges, units)) else push_all

    def _direct(self, read: list[tuple[int, Node]], nodes: list[Node], push: Push, *others: Push) -> Push:
        """Return a function that pushes batches into segments of these nodes, and names one that fails."""
        alone = not (read or others)
        if alone and compiler() and all(map(_is_tested, nodes)):  # no error is possible
            return push

        def push_fused(*batches: Batch) -> list[Delivery]:
            try:
                if alone:
                    return push(*batches)
                made = [output for each in (push, *others) for output in each(*batches)]
            except Exception as error:
                raise self._failure(nodes, error) from error
            return [*((node, batches[i]) for i, node in read), *made]

        return push_fused

    def flush(self) -> list[Delivery]:
        """End all streams, and return the last batches for sinks, in order."""
        values: Values = {}
        deliveries: list[Delivery] = []
        for unit in self._units:
            self._run(unit, unit.flush, values, deliveries)
        return deliveries

    def _run(
        self,
        unit: _Fused | _Single,
        step: Callable[[Values], list[Delivery]],
        values: Values,
        deliveries: list[Delivery],
    ) -> None:
        """Run a unit, and add its output to the values and deliveries."""
        try:
            outputs = step(values)
        except Exception as error:
            raise self._failure(unit.nodes, error) from error
        for node, batch in outputs:
            key = node, batch.finger
            values[key] = concat(type(batch), [values[key], batch]) if key in values else batch
            if node in self._read:
                deliveries.append((node, batch))

    def _failure(self, nodes: Sequence[Node], error: Exception) -> OperatorError:
        node = min(nodes, key=lambda each: (not location(_code(each), error), _is_tested(each)))
        kind = "" if isinstance(error, SlipflowError) else f"{type(error).__name__}: "
        reason = f"{kind}{error}".removesuffix(": ")
        reason += "" if _is_tested(node) else location(_code(node), error)
        return OperatorError(self._flow, node.name, reason)

    def _compiled(self, flow: Flow) -> list[_Fused | _Single]:
        """Return the units of a flow, each after those that it reads from.

        Operators are fused with those before them that have the same fingertips, unless an operator with a
        `process` of its own stands between them: the rank of a unit counts the borders before it.
        """
        fingertips, _ = trace_fingertips(flow)
        types, ranks, fused = dict[Node, RowType](), dict[Node, int](), dict[Node, Steps]()
        units = list[tuple[int, _Fused | _Single]]()
        for node in flow.nodes:  # each after its inputs
            if isinstance(node.part, Source):
                cells = fingertips[node].cells if node in fingertips else BAROMETERS
                types[node], ranks[node] = RowType(node.part.exact_kind, cells), 0
            if not isinstance(node.part, Operator | Join):
                continue
            given = [types[parent] for parent in node.inputs]
            try:
                known = fingertips.get(node.inputs[0])
                part = node.part if known is None else node.part.for_fingertip(known)
                operators = [part.reset_copy() for _ in node.fingers]
                steps = operators[0].steps(*given) if fuses(type(operators[0])) else None
                types[node] = operators[0].row_type(*given)
                require_process(operators[0])
            except SlipflowError:
                raise
            except Exception as error:
                raise self._failure([node], error) from error
            if steps is None:
                ranks[node] = 1 + max(ranks[parent] for parent in node.inputs)
                singles = zip(operators, node.fingers, strict=True)
                units += [(ranks[node], _Single(node, each, finger, given)) for each, finger in singles]
                continue
            fused[node] = steps
            ranks[node] = max(
                ranks[parent] + (parent not in fused or parent.fingers != node.fingers)
                for parent in node.inputs
            )
        for rank, fingers in dict.fromkeys((ranks[node], node.fingers) for node in fused):
            inside = {n: steps for n, steps in fused.items() if (ranks[n], n.fingers) == (rank, fingers)}
            read = {parent for node in flow.nodes if node not in inside for parent in node.inputs}
            units.append((rank, self._fused(inside, types, read)))
        return [unit for _, unit in sorted(units, key=lambda each: each[0])]

    def _fused(self, nodes: Mapping[Node, Steps], types: Mapping[Node, RowType], read: set[Node]) -> _Fused:
        try:
            return _Fused(nodes, types, read)
        except Exception as error:
            for node in sorted(nodes, key=_is_tested) if len(nodes) > 1 else ():  # those of users first
                self._fused({node: nodes[node]}, types, {node})
            raise self._failure([*nodes], error) from error

    def _reached(self, reached: set[Node]) -> list[_Fused | _Single]:
        """Return the units that rows of these sources may reach."""
        units = list[_Fused | _Single]()
        for unit in self._units:
            if reached.intersection(unit.entrances):
                reached.update(unit.nodes)
                units.append(unit)
        return units


def _merges(unit: _Fused | _Single) -> bool:
    """Return whether a user's join reads from another unit, which may hold rows back; ours wait by time."""
    joins = any(isinstance(node.part, Join) and not _is_tested(node) for node in unit.nodes)
    return joins and not all(isinstance(node.part, Source) for node in unit.entrances)


def _by_instant(push: Push) -> Push:
    """Return a function that pushes the rows of one instant after those of another, as a live run does.

    Else a join would sort rows that an operator held back among those that arrived with them.
    """

    def push_each(*batches: Batch) -> list[Delivery]:
        if sum(map(len, batches)) <= 1:
            return push(*batches)
        reached = [np.maximum.accumulate(batch.time) for batch in batches]  # late rows stay after others
        instants = np.unique(np.concatenate(reached))
        cuts = [np.searchsorted(times, instants, "right").tolist() for times in reached]
        pieces = zip(*(zip([0, *each], each, strict=False) for each in cuts), strict=True)
        return [
            delivery
            for spans in pieces
            for delivery in push(*(each[a:b] for each, (a, b) in zip(batches, spans, strict=True)))
        ]

    return push_each


def _fingers(sink: Node, stream: Node) -> tuple[int, ...]:
    """Return the fingertips of all streams of a sink that have the type of `stream`."""
    return tuple(sorted({f for each in sink.inputs if each.gives is stream.gives for f in each.fingers}))


def _code(node: Node) -> object:
    """Return the operator of a node, or the detector of a `Score`."""
    return node.part.detector if type(node.part) is Score else node.part


def _is_tested(node: Node) -> bool:
    """Return True for an operator or detector of slipflow, whose tests check its output."""
    return type(_code(node)).__module__.startswith("operators.")

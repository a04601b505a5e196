"""Program of a segment: functions that pass a row on from step to step, composed by their global names.

A row goes through ``NEXT(flow, outputs, row)``; `flow` is a record of one fingertip, with settings, state
and the row of each operator; `outputs` is a record of its rows for sinks. `bind` sets the names in capitals.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from types import FunctionType
from typing import Any, Final, NamedTuple, TypeAlias, cast

import numpy as np

from operators.steps import Record, RowType, Steps, copy, record_type

Choice: TypeAlias = tuple[int, ...]  # entrances
BLOCK: Final = 4096  # rows per call

STEP = TAKE = GIVE = NEXT = OTHER = END = TIME = cast("Any", None)  # functions
SETTINGS = STATE = MADE = STOP = OUT = ""  # fields of records
ENTRANCES, LIMIT = 1, BLOCK
BEGIN, GO_ON, FINISH = range(3)  # what a call does with rows
LATEST = 2**63 - 1  # ns


class Shape(NamedTuple):
    """What a program needs to know of an operator: its functions and the types of its records."""

    functions: tuple[Any, ...]  # step, takes, give
    contents: tuple[str, ...]  # names of all that is compiled in; of Python, none
    settings: np.dtype[Any]
    state: np.dtype[Any]
    gives: RowType
    inputs: tuple[int, ...]
    delivers: bool
    held: int
    factor: int

    @classmethod
    def of(
        cls, steps: Steps, gives: RowType, inputs: tuple[int, ...], delivers: bool, *, compiled: bool
    ) -> "Shape":
        """Return the shape of an operator; see `Stage`."""
        functions, contents = steps.functions(), tuple[str, ...]()
        records = record_type(steps.settings), record_type(steps.state)
        if compiled:
            from operators.compilation import content_name

            contents = tuple(content_name(each, {}) for each in functions)
        named = steps.step, tuple(steps.takes), steps.give
        return cls(named, contents, *records, gives, inputs, delivers, steps.held, steps.factor)


class Program(NamedTuple):
    """Program of a segment, with the types of its records."""

    drives: dict[Choice, Callable[..., int]]  # by the entrances whose rows they take: all, or one
    flow: np.dtype[Any]  # record of one fingertip
    outputs: np.dtype[Any]  # record of its rows for sinks
    order: Choice  # all entrances, in the order of rows of equal time


@lru_cache(64)
def compose(
    entrances: tuple[RowType, ...], shapes: tuple[Shape, ...], compiler: Callable[..., Any] | None
) -> Program:
    """Return the program of a segment.

    Args:
        entrances: Types of the rows that enter.
        shapes: Operators, each after its inputs.
        compiler: Function that compiles a function for the types of some arguments; None: it runs as Python.
    """
    number, capacities = len(entrances), _capacities(len(entrances), shapes)
    limit = max(1, BLOCK // max(factor for _, factor in capacities))
    order = tuple(sorted(range(number), key=_first_in_ties(number, shapes)))
    numbers = np.int64, (number,)
    fields: list[Any] = [("waiting", np.int64), ("heads", *numbers), ("reached", *numbers)]
    fields += [(f"enter{i}", [("newest", np.int64), ("late", np.int64)]) for i in range(number)]
    places: list[Any] = [("none", np.uint8)]
    for i, (shape, (extra, factor)) in enumerate(zip(shapes, capacities, strict=True)):
        fields += [(f"settings{i}", shape.settings), (f"state{i}", shape.state)]
        fields += [(f"made{i}", shape.gives.packed), (f"stop{i}", np.int64)]
        if shape.delivers:
            places.append((f"out{i}", shape.gives.packed, (limit * factor + extra,)))
    flow, outputs = np.dtype(fields, align=True), np.dtype(places, align=True)
    drives = dict[Choice, Callable[..., int]]()
    known = dict[FunctionType, Any]()  # compiled functions
    for chosen, function in _composed(shapes, order, limit).items():
        rows = tuple(np.empty(0, entrances[i].packed) for i in chosen)
        arguments = np.zeros(1, flow), np.zeros(1, outputs), rows, BEGIN
        drives[chosen] = compiler(function, arguments, known) if compiler else _as_python(function)
    return Program(drives, flow, outputs, order)


def _as_python(function: Callable[..., int]) -> Callable[..., int]:
    """Return a function that gives records to a program, whose fields are attributes."""

    def drive(flows: Any, outputs: Any, rows: Any, phase: int) -> int:
        flows, outputs, *parts = (each.view(np.recarray) for each in (flows, outputs, *rows))
        return function(flows, outputs, tuple(parts), phase)

    return drive


def _composed(shapes: Sequence[Shape], order: Choice, limit: int) -> dict[Choice, FunctionType]:
    """Return `drive` for rows of all entrances and of each, bound to the functions of the operators."""
    number = len(order)
    after: list[Any] = [drop] * (number + len(shapes))  # what reads from each entrance and operator
    ends: Any = end_none
    for i, shape in reversed(list(enumerate(shapes))):
        (step, takes, give), names = shape.functions, {"SETTINGS": f"settings{i}", "STATE": f"state{i}"}
        if shape.delivers:
            delivered = bind(deliver, OUT=f"out{i}", STOP=f"stop{i}")
            after[number + i] = _both(delivered, after[number + i])
        names |= {"MADE": f"made{i}", "NEXT": after[number + i]}
        for side, source in enumerate(shape.inputs):
            if step is not None:
                reader = bind(pass_through, STEP=step, **names)
            else:
                reader = bind(take_and_give, TAKE=takes[side], GIVE=give, **names)
            after[source] = _both(reader, after[source])
        if give is not None and "ended" in (shape.state.names or ()):
            ends = bind(end, GIVE=give, OTHER=ends, **names)
    found = dict[Choice, FunctionType]()
    for chosen in (order, *((i,) for i in order)):
        ways = times = None
        for i in reversed(chosen):
            way = bind(enter, STATE=f"enter{i}", NEXT=after[i])
            ways = bind(choose_last if ways is None else choose, NEXT=way, OTHER=ways)
            times = bind(time_of_last if times is None else time_of, OTHER=times)
        functions = {"NEXT": ways, "END": ends, "TIME": times}
        found[chosen] = bind(drive, ENTRANCES=len(chosen), LIMIT=limit, **functions)
    return found


def _both(first: Any, second: Any) -> Any:
    """Return a function that passes a row two ways."""
    return first if second is drop else bind(fork, NEXT=first, OTHER=second)


def _capacities(entrances: int, shapes: Sequence[Shape]) -> list[tuple[int, int]]:
    """Return how many rows each operator may give besides those of a call, and how many per row of it."""
    found: list[tuple[int, int]] = [(0, 1)] * entrances
    for shape in shapes:
        inputs = [found[i] for i in shape.inputs]
        factor = shape.factor * max(each[1] for each in inputs)
        factor = 1 << (factor - 1).bit_length()  # so that few programs serve all parameters
        found.append((shape.factor * sum(each[0] for each in inputs) + shape.held, factor))
    return found[entrances:]


def _first_in_ties(entrances: int, shapes: Sequence[Shape]) -> Callable[[int], bool]:
    """Return a key that puts entrances first from which the second input of a join comes."""
    reaches: list[set[int]] = [{i} for i in range(entrances)]
    first = set[int]()
    for shape in shapes:
        for source in shape.inputs[1:]:
            first |= reaches[source]
        reaches.append(set[int]().union(*(reaches[source] for source in shape.inputs)))
    return lambda entrance: entrance not in first


def bind(template: Callable[..., Any], **names: object) -> FunctionType:
    """Return a copy of a function in which global names have other values."""
    function = cast("FunctionType", template)
    return FunctionType(function.__code__, {**function.__globals__, **names}, function.__name__)


def drop(flow: Record, outputs: Record, row: Record) -> None:
    """End the path of a row that nothing reads."""


def pass_through(flow: Record, outputs: Record, row: Record) -> None:
    """Pass a row through a step."""
    made = flow[MADE]
    if STEP(flow[SETTINGS], flow[STATE], row, made):
        NEXT(flow, outputs, made)


def take_and_give(flow: Record, outputs: Record, row: Record) -> None:
    """Pass a row to an operator, and on all rows that it gives."""
    TAKE(flow[SETTINGS], flow[STATE], row)
    made = flow[MADE]
    while GIVE(flow[SETTINGS], flow[STATE], made):
        NEXT(flow, outputs, made)


def deliver(flow: Record, outputs: Record, row: Record) -> None:
    """Store a row for those outside the segment, if there is room."""
    stop = flow[STOP]
    if stop < len(outputs[OUT]):
        copy(outputs[OUT][stop], row)
    flow[STOP] = stop + 1
    flow.waiting += 1


def fork(flow: Record, outputs: Record, row: Record) -> None:
    """Pass a row two ways."""
    NEXT(flow, outputs, row)
    OTHER(flow, outputs, row)


def enter(flow: Record, outputs: Record, row: Record) -> None:
    """Pass a row on unless it is late: older than the newest one before it."""
    entrance = flow[STATE]
    if row.time < entrance.newest:
        entrance.late += 1
    else:
        entrance.newest = row.time
        NEXT(flow, outputs, row)


def choose(flow: Record, outputs: Record, entrance: int, index: int, rows: Any) -> None:
    """Let a row of one of several entrances in."""
    if entrance == 0:
        NEXT(flow, outputs, rows[0][index])
    else:
        OTHER(flow, outputs, entrance - 1, index, rows[1:])


def choose_last(flow: Record, outputs: Record, entrance: int, index: int, rows: Any) -> None:
    """Let a row of the last entrance in."""
    NEXT(flow, outputs, rows[0][index])


def end_none(flow: Record, outputs: Record) -> None:
    """End a segment without operators that hold rows."""


def end(flow: Record, outputs: Record) -> None:
    """End the stream of an operator, then of those after it."""
    flow[STATE].ended = 1
    made = flow[MADE]
    while GIVE(flow[SETTINGS], flow[STATE], made):
        NEXT(flow, outputs, made)
    OTHER(flow, outputs)


def time_of(rows: Any, entrance: int, index: int) -> int:
    """Return the time of a row of one of several entrances, ns; `LATEST` after its last row."""
    if entrance == 0:
        return int(rows[0][index].time) if index < len(rows[0]) else LATEST
    return int(OTHER(rows[1:], entrance - 1, index))


def time_of_last(rows: Any, entrance: int, index: int) -> int:
    """Return the time of a row of the last entrance, ns."""
    return int(rows[0][index].time) if index < len(rows[0]) else LATEST


def drive(flows: Any, outputs: Any, rows: Any, phase: int) -> int:
    """Let rows in, in the order of time; return how many wait for sinks, or -1 less that if some are left.

    Of equal times, those of the first entrance come first. A late row stays after the rows before it.

    Args:
        flows: Record of the fingertip, (1,).
        outputs: Record of its rows for sinks, (1,).
        rows: Packed rows of each entrance.
        phase: `BEGIN`; `GO_ON` with rows that the call before left; `FINISH`: the streams end after these.
    """
    flow = flows[0]
    flow.waiting = 0
    if phase != GO_ON:
        for entrance in range(ENTRANCES):
            flow.heads[entrance], flow.reached[entrance] = 0, TIME(rows, entrance, 0)
    for _ in range(LIMIT):
        entrance = 0
        for other in range(1, ENTRANCES):
            if flow.reached[other] < flow.reached[entrance]:
                entrance = other
        reached = flow.reached[entrance]
        if reached == LATEST:
            if phase == FINISH:
                END(flow, outputs[0])
            return int(flow.waiting)
        head = flow.heads[entrance]
        NEXT(flow, outputs[0], entrance, head, rows)
        flow.heads[entrance] = head + 1
        flow.reached[entrance] = max(reached, TIME(rows, entrance, head + 1))
    return -1 - int(flow.waiting)

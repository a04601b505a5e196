"""Program of a segment: functions that pass a row on from step to step, composed by their global names.

A row goes through ``NEXT(settings, flow, row)``; `flow` is the record of one fingertip, with the state of
each operator, the row that it writes and the rows that wait for sinks. `bind` binds the names in capitals.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from types import FunctionType
from typing import Any, Final, NamedTuple, cast

import numpy as np

from operators.steps import Record, RowType, Steps, copy, record_type

BLOCK: Final = 4096  # rows per call

STEP = TAKE = GIVE = NEXT = OTHER = END = WAITING = CLEAR = TIME = cast("Any", None)  # functions
STATE = MADE = OUT = COUNT = ""  # fields of `flow`
ENTRANCES = 1
LATEST = 2**63 - 1  # ns


class Shape(NamedTuple):
    """What a program needs to know of an operator: its functions and the types of its records."""

    functions: tuple[Any, ...]  # step, takes, give
    settings: np.dtype[Any]
    state: np.dtype[Any]
    gives: RowType
    inputs: tuple[int, ...]
    delivers: bool
    held: int
    factor: int

    @classmethod
    def of(cls, steps: Steps, gives: RowType, inputs: tuple[int, ...], delivers: bool) -> "Shape":
        """Return the shape of an operator; see `Stage`."""
        functions = steps.step, steps.takes, steps.give
        records = record_type(steps.settings), record_type(steps.state)
        return cls(functions, *records, gives, inputs, delivers, steps.held, steps.factor)


class Program(NamedTuple):
    """Program of a segment, with the types of its records."""

    drive: Callable[..., int]
    block: np.dtype[Any]  # record of one fingertip
    settings: np.dtype[Any]
    order: tuple[int, ...]  # entrances, in the order of rows of equal time
    rows: int  # largest number per call


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
    rows = max(1, BLOCK // max(factor for _, factor in capacities))
    order = tuple(sorted(range(number), key=_first_in_ties(number, shapes)))
    settings: list[Any] = [("none", np.uint8)]
    fields: list[Any] = [("heads", np.int64, (number,)), ("reached", np.int64, (number,))]
    fields += [(f"enter{i}", [("newest", np.int64), ("late", np.int64)]) for i in range(number)]
    for i, (shape, (extra, factor)) in enumerate(zip(shapes, capacities, strict=True)):
        settings.append((f"stage{i}", shape.settings))
        fields += [(f"stage{i}", shape.state), (f"made{i}", shape.gives.packed)]
        if shape.delivers:
            fields += [(f"out{i}", shape.gives.packed, (rows * factor + extra,)), (f"count{i}", np.int64)]
    block, constants = np.dtype(fields, align=True), np.dtype(settings, align=True)
    function = _composed(shapes, order)
    if compiler is None:
        return Program(_as_python(function), block, constants, order, rows)
    empty = tuple(np.empty(0, entrances[i].packed) for i in order)
    compiled = compiler(function, (np.zeros(1, constants), np.zeros(1, block), 0, 0, empty, False))
    return Program(compiled, block, constants, order, rows)


def _as_python(function: Callable[..., int]) -> Callable[..., int]:
    """Return a function that gives records to a program, whose fields are attributes."""

    def drive(settings: Any, block: Any, first: int, last: int, rows: Any, ended: bool) -> int:
        settings, block, *parts = (each.view(np.recarray) for each in (settings, block, *rows))
        return function(settings, block, first, last, tuple(parts), ended)

    return drive


def _composed(shapes: Sequence[Shape], order: Sequence[int]) -> FunctionType:
    """Return `drive`, bound to the functions of the operators."""
    number = len(order)
    after: list[Any] = [drop] * (number + len(shapes))  # what reads from each entrance and operator
    ends, awaited, cleared = cast("tuple[Any, Any, Any]", (end_none, count_none, clear_none))
    for i, shape in reversed(list(enumerate(shapes))):
        (step, takes, give), names = shape.functions, {"STATE": f"stage{i}", "MADE": f"made{i}"}
        if shape.delivers:
            outlet = {"OUT": f"out{i}", "COUNT": f"count{i}"}
            after[number + i] = _both(bind(deliver, **outlet), after[number + i])
            awaited, cleared = (
                bind(count_waiting, OTHER=awaited, **outlet),
                bind(clear_outlet, OTHER=cleared, **outlet),
            )
        names["NEXT"] = after[number + i]
        for side, source in enumerate(shape.inputs):
            if step is not None:
                reader = bind(pass_through, STEP=step, **names)
            else:
                reader = bind(take_and_give, TAKE=takes[side], GIVE=give, **names)
            after[source] = _both(reader, after[source])
        if "ended" in (shape.state.names or ()):
            ends = bind(end, GIVE=give, OTHER=ends, **names)
    ways = times = None
    for i in reversed(order):
        way = bind(enter, STATE=f"enter{i}", NEXT=after[i])
        ways = bind(choose_last if ways is None else choose, NEXT=way, OTHER=ways)
        times = bind(time_of_last if times is None else time_of, OTHER=times)
    functions = {"NEXT": ways, "END": ends, "WAITING": awaited, "CLEAR": cleared, "TIME": times}
    return bind(drive, ENTRANCES=number, **functions)


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


def drop(settings: Record, flow: Record, row: Record) -> None:
    """End the path of a row that nothing reads."""


def pass_through(settings: Record, flow: Record, row: Record) -> None:
    """Pass a row through a step."""
    made = flow[MADE]
    if STEP(settings[STATE], flow[STATE], row, made):
        NEXT(settings, flow, made)


def take_and_give(settings: Record, flow: Record, row: Record) -> None:
    """Pass a row to an operator, and on all rows that it gives."""
    TAKE(settings[STATE], flow[STATE], row)
    made = flow[MADE]
    while GIVE(settings[STATE], flow[STATE], made):
        NEXT(settings, flow, made)


def deliver(settings: Record, flow: Record, row: Record) -> None:
    """Store a row for those outside the segment, if there is room."""
    if flow[COUNT] < len(flow[OUT]):
        copy(flow[OUT][flow[COUNT]], row)
    flow[COUNT] += 1


def fork(settings: Record, flow: Record, row: Record) -> None:
    """Pass a row two ways."""
    NEXT(settings, flow, row)
    OTHER(settings, flow, row)


def enter(settings: Record, flow: Record, row: Record) -> None:
    """Pass a row on unless it is late: older than the newest one before it."""
    entrance = flow[STATE]
    if row.time < entrance.newest:
        entrance.late += 1
    else:
        entrance.newest = row.time
        NEXT(settings, flow, row)


def choose(settings: Record, flow: Record, entrance: int, index: int, rows: Any) -> None:
    """Let a row of one of several entrances in."""
    if entrance == 0:
        NEXT(settings, flow, rows[0][index])
    else:
        OTHER(settings, flow, entrance - 1, index, rows[1:])


def choose_last(settings: Record, flow: Record, entrance: int, index: int, rows: Any) -> None:
    """Let a row of the last entrance in."""
    NEXT(settings, flow, rows[0][index])


def end_none(settings: Record, flow: Record) -> None:
    """End a segment without operators that hold rows."""


def end(settings: Record, flow: Record) -> None:
    """End the stream of an operator, then of those after it."""
    flow[STATE].ended = 1
    made = flow[MADE]
    while GIVE(settings[STATE], flow[STATE], made):
        NEXT(settings, flow, made)
    OTHER(settings, flow)


def count_none(flow: Record) -> int:
    """Return the number of rows that wait without outlets."""
    return 0


def clear_none(flow: Record) -> None:
    """Forget nothing: there are no outlets."""


def clear_outlet(flow: Record) -> None:
    """Forget the rows that were taken from this outlet and the others."""
    flow[COUNT] = 0
    OTHER(flow)


def count_waiting(flow: Record) -> int:
    """Return the number of rows that wait in this outlet and the others."""
    return int(flow[COUNT]) + int(OTHER(flow))


def time_of(rows: Any, entrance: int, index: int) -> int:
    """Return the time of a row of one of several entrances, ns; `LATEST` after its last row."""
    if entrance == 0:
        return int(rows[0][index].time) if index < len(rows[0]) else LATEST
    return int(OTHER(rows[1:], entrance - 1, index))


def time_of_last(rows: Any, entrance: int, index: int) -> int:
    """Return the time of a row of the last entrance, ns."""
    return int(rows[0][index].time) if index < len(rows[0]) else LATEST


def drive(settings: Any, block: Any, first: int, last: int, rows: Any, ended: bool) -> int:
    """Let rows in, in the order of time; return how many rows wait for sinks.

    Of equal times, those of the first entrance come first. A late row stays after the rows before it.

    Args:
        settings: Record of the settings, (1,).
        block: Records of the fingertips.
        first: Number of the first fingertip.
        last: Number after the last fingertip.
        rows: Packed rows of each entrance.
        ended: Whether the streams end after these rows.
    """
    count = 0
    for slot in range(first, last):
        flow = block[slot]
        CLEAR(flow)
        for entrance in range(ENTRANCES):
            flow.heads[entrance], flow.reached[entrance] = 0, TIME(rows, entrance, 0)
        while True:
            entrance = 0
            for other in range(1, ENTRANCES):
                if flow.reached[other] < flow.reached[entrance]:
                    entrance = other
            reached = flow.reached[entrance]
            if reached == LATEST:
                break
            head = flow.heads[entrance]
            NEXT(settings[0], flow, entrance, head, rows)
            flow.heads[entrance] = head + 1
            flow.reached[entrance] = max(reached, TIME(rows, entrance, head + 1))
        if ended:
            END(settings[0], flow)
        count += WAITING(flow)
    return count

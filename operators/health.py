"""Detection of faulty barometers."""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from math import inf
from typing import Final, Self

import numpy as np

from operators.batch import Faults, Times, Touch, Zeroed, ms, s
from operators.checks import check_above, check_at_least
from operators.fingertip import TAKKTILE, Fingertip
from operators.operator import Operator
from operators.steps import Record, RowType, Steps

_SATURATED_AFTER: Final = 50 * ms  # at the end of the range
_PAUSE: Final = 25 * ms  # that a pause of the stream counts as at most
_PERIODS: Final = 2.5  # of a slow fingertip, that it counts as at most


class FaultKind(IntEnum):
    """Kind of a barometer's fault."""

    DEAD = 0
    STUCK = 1
    SATURATED = 2
    DRIFTING = 3  # in older recordings; no longer detected


@dataclass
class Health(Operator[Touch, Faults]):
    """Report the start and end of each barometer's faults: dead, stuck or saturated.

    - dead: no answer for `dead_after`.
    - stuck: valid counts unchanged for `stuck_after`. Noise changes the counts of a working cell within a few
      readings. A cell that reaches the end of its range is saturated; if it begins there, it is also stuck.
    - saturated: raw counts in the first or last 1 % of the range for 50 ms. Overload wraps from 0 to 1023, so
      both ends indicate it. The cell is not broken, but its range ends: events keep the quality `good`. Not
      detected in zeroed counts, or if the range is unknown.

    A fault ends after `clear_after` without it. A value above 0 merges the faults of a cell that is often
    pressed to the end of its range. Rows of equal time are ordered by cell, then kind. A pause of the stream
    counts as at most 25 ms, or 2.5 periods of a slow fingertip.

    Args:
        dead_after: Time without answer, ns.
        stuck_after: Time without change, ns.
        clear_after: Time without fault that ends it, ns.
        fingertip: Fingertip of the input, which a flow sets.

    Raises:
        ParameterError: if a parameter is invalid.

    >>> time, cells = np.arange(0, 1000 * ms, 10 * ms), np.zeros((100, 6), np.int16)
    >>> faults = Health().push(Touch(time, cells + 500, cells, np.arange(6) + cells != 2))
    >>> faults.barometer, faults.kind, faults.time // ms
    (array([2], dtype=int8), array([0], dtype=int8), array([500]))
    """

    dead_after: int = 500 * ms
    stuck_after: int = 2 * s
    clear_after: int = 0
    fingertip: Fingertip = field(default=TAKKTILE, repr=False)

    def __post_init__(self) -> None:
        for name in ("dead_after", "stuck_after"):
            check_above("Health", name, getattr(self, name), 0, "ns")
        check_at_least("Health", "clear_after", self.clear_after, 0, "ns")

    def for_fingertip(self, given: Fingertip) -> Self:
        """Return the operator for the range and rate of the fingertip."""
        return replace(self, fingertip=given)

    def steps(self, *given: RowType) -> Steps:
        """Return the functions that examine a row and give the faults that start or end in it."""
        cells, zeroed = given[0].cells, issubclass(given[0].kind, Zeroed)
        # no count of 16 bits is at the ends of an unknown range
        low, high = sorted(self.fingertip.range or (-(1 << 16), 1 << 16))
        end = (high - low) // 100
        table = np.zeros((_IN_RANGE + 1, cells), np.int64)
        table[_LAST], table[_FAULTY:_IN_RANGE] = (low + high) // 2, -self.clear_after
        after = self.dead_after, self.stuck_after, _SATURATED_AFTER, self.clear_after
        return Steps(
            settings={
                "after": np.array(after),  # ns
                "floor": -inf if zeroed else float(low + end),
                "ceiling": inf if zeroed else float(high - end),
                "pause": max(_PAUSE, round(_PERIODS * s / self.fingertip.rate)),
            },
            state={
                "table": table,
                "active": np.zeros((cells, _KINDS), np.uint8),
                "changed": np.zeros((cells, _KINDS), np.uint8),  # in the newest row
                "changes": 0,  # number of these
                "time": 0,  # ns, newest row
                "age": 0,  # ns
                "begun": 0,
            },
            takes=(_examine,),
            give=_give_fault,
            factor=_KINDS * cells,
        )


_DEAD, _STUCK, _SATURATED = range(3)
_KINDS = 3  # that are detected
# Rows of the table: last valid counts; age when last sound and when last faulty, by kind; 1 if ever in range.
_LAST, _SOUND, _FAULTY, _IN_RANGE = 0, 1, 4, 7


def _examine(settings: Record, state: Record, row: Record) -> None:
    """Mark the faults that start or end in a row."""
    if not state.begun:
        state.time = row.time
        state.begun = 1
    state.age += min(row.time - state.time, settings.pause)
    state.time = row.time
    age, table = state.age, state.table
    for cell in range(len(row.counts)):
        before = table[_LAST, cell]
        if row.valid[cell]:
            table[_LAST, cell] = row.counts[cell]
            table[_SOUND + _DEAD, cell] = age
        dead = _lasts(table, _DEAD, cell, age, settings.after)
        within = settings.floor < table[_LAST, cell] < settings.ceiling
        if dead or within:
            table[_SOUND + _SATURATED, cell] = age
            if dead or row.valid[cell]:
                table[_IN_RANGE, cell] = 1
        overloaded = not within and table[_IN_RANGE, cell]  # not so from the beginning
        if dead or overloaded or table[_LAST, cell] != before:
            table[_SOUND + _STUCK, cell] = age
        stuck = _lasts(table, _STUCK, cell, age, settings.after)
        saturated = _lasts(table, _SATURATED, cell, age, settings.after)
        now = dead, stuck, saturated
        for kind in range(_KINDS):
            if now[kind] != (state.active[cell, kind] != 0):
                state.active[cell, kind] = now[kind]
                state.changed[cell, kind] = 1
                state.changes += 1


def _give_fault(settings: Record, state: Record, out: Record) -> bool:
    if not state.changes:
        return False
    for cell in range(len(state.changed)):
        for kind in range(_KINDS):
            if state.changed[cell, kind]:
                state.changed[cell, kind] = 0
                state.changes -= 1
                out.time, out.barometer, out.kind = state.time, cell, kind
                out.active = state.active[cell, kind]
                return True
    return False


def _lasts(table: Times, kind: int, cell: int, age: int, after: Times) -> bool:
    """Return whether a cell has been faulty for the kind's time, now or within `clear_after`."""
    faulty = bool(age - table[_SOUND + kind, cell] >= after[kind])
    if faulty:
        table[_FAULTY + kind, cell] = age
    return faulty or bool(age - table[_FAULTY + kind, cell] < after[3])

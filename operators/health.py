"""Detection of faulty barometers."""

from dataclasses import dataclass, replace
from enum import IntEnum
from math import inf, isnan
from typing import Final, Self

import numpy as np

from operators.batch import Faults, Times, Touch, Zeroed, ms, s
from operators.checks import check_above, check_at_least
from operators.errors import ParameterError
from operators.fingertip import TAKKTILE, Fingertip
from operators.operator import Operator
from operators.steps import Record, RowType, Steps

_PAUSE: Final = 25 * ms  # ns, longer pauses of the stream count as this long
_QUIET: Final = 1.0  # counts, standard deviation; 0.43 to 0.7 unloaded, 4 to 10 under a static load
_READINGS: Final = 10  # least number of readings in a quiet second


class FaultKind(IntEnum):
    """Kind of a barometer's fault."""

    DEAD = 0
    STUCK = 1
    SATURATED = 2
    DRIFTING = 3


@dataclass
class Health(Operator[Touch, Faults]):
    """Report the start and end of each barometer's faults: dead, stuck, saturated or drifting.

    - dead: no answer for `dead_after`.
    - stuck: valid counts unchanged for `stuck_after`. Noise changes the counts of a working cell within a few
      readings. A cell that reaches the end of its range is saturated; if it begins there, it is also stuck.
    - saturated: raw counts at `floor` or below, or at `ceiling` or above, for `saturated_after`. Overload
      wraps from 0 to 1023, so both ends indicate it. The cell is not broken, but its range ends: events
      keep the quality `good`. Not detected in zeroed counts, or if the range is unknown.
    - drifting: the mean of a quiet second differs by more than `drift` from that of the first one. In a quiet
      second the standard deviation of every cell is below 1 count, as if unloaded. So start unloaded; drift
      in contact or next to a noisy cell is not detected. A perfectly constant load is reported as drift; so
      is a cell at its floor in zeroed counts. Seconds count from the first row.

    All faults except drift end after `clear_after` without fault. A value above 0 merges the faults of a
    cell that is repeatedly pressed to the end of its range. Pauses of the stream count as 25 ms at most. Rows
    of equal time are ordered by cell, then kind.

    Args:
        dead_after: Time without answer, ns.
        stuck_after: Time without change, ns.
        saturated_after: Time at the end of the range, ns.
        clear_after: Time without fault that ends it, ns.
        floor: Highest saturated raw count at the low end; None: 1 % of the fingertip's range.
        ceiling: Lowest saturated raw count at the high end; None: 99 % of it.
        drift: Largest difference of means without a fault, counts.

    Raises:
        ParameterError: if a parameter is invalid.

    >>> time, cells = np.arange(0, 1000 * ms, 10 * ms), np.zeros((100, 6), np.int16)
    >>> faults = Health().push(Touch(time, cells + 500, cells, np.arange(6) + cells != 2))
    >>> faults.barometer, faults.kind, faults.time // ms
    (array([2], dtype=int8), array([0], dtype=int8), array([500]))
    """

    dead_after: int = 500 * ms
    stuck_after: int = 2 * s
    saturated_after: int = 50 * ms
    clear_after: int = 0
    floor: int | None = None
    ceiling: int | None = None
    drift: float = 30.0

    def __post_init__(self) -> None:
        for name in ("dead_after", "stuck_after", "saturated_after"):
            check_above("Health", name, getattr(self, name), 0, "ns")
        check_above("Health", "drift", self.drift, 0, "counts")
        check_at_least("Health", "clear_after", self.clear_after, 0, "ns")
        if self.floor is not None and self.ceiling is not None and self.floor >= self.ceiling:
            raise ParameterError("Health", "floor", self.floor, f"below ceiling, {self.ceiling}")

    def for_fingertip(self, given: Fingertip) -> Self:
        """Return the operator with the floor and ceiling of the fingertip's range, unless they are given."""
        low, high = sorted(given.range or (-(1 << 16), 1 << 16))  # no count of 16 bits is at its ends
        end = (high - low) // 100
        floor = low + end if self.floor is None else self.floor
        return replace(self, floor=floor, ceiling=high - end if self.ceiling is None else self.ceiling)

    def steps(self, *given: RowType) -> Steps:
        """Return the functions that examine a row and give the faults that start or end in it."""
        if self.floor is None or self.ceiling is None:
            return self.for_fingertip(TAKKTILE).steps(*given)
        cells, zeroed = given[0].cells, issubclass(given[0].kind, Zeroed)
        table = np.zeros((_SUMS + 3, cells), np.int64)
        table[_LAST], table[_FAULTY:_SUMS] = (self.floor + self.ceiling) // 2, -self.clear_after
        after = self.dead_after, self.stuck_after, self.saturated_after, self.clear_after
        return Steps(
            settings={
                "after": np.array(after),  # ns
                "floor": -inf if zeroed else float(self.floor),
                "ceiling": inf if zeroed else float(self.ceiling),
                "drift": float(self.drift),
            },
            state={
                "table": table,
                "active": np.zeros((cells, len(FaultKind)), np.uint8),
                "changed": np.zeros((cells, len(FaultKind)), np.uint8),  # in the newest row
                "changes": 0,  # number of these
                "first": np.full(cells, np.nan),  # mean of the first quiet second
                "time": 0,  # ns, newest row
                "age": 0,  # ns
                "begun": 0,
                "start": 0,  # ns, first row
            },
            takes=(_examine,),
            give=_give_fault,
            factor=len(FaultKind) * cells,
        )


# Rows of the table: last valid counts; age when last sound and when last faulty, by kind (dead, stuck,
# saturated); number, sum and sum of squares of the current second's readings.
_LAST, _SOUND, _FAULTY, _SUMS = 0, 1, 4, 7
_DEAD, _STUCK, _SATURATED, _DRIFTING = range(4)


def _examine(settings: Record, state: Record, row: Record) -> None:
    """Mark the faults that start or end in a row."""
    if not state.begun:
        state.time = state.start = row.time
        state.begun = 1
    ends_second = (row.time - state.start) // s != (state.time - state.start) // s
    state.age += min(row.time - state.time, _PAUSE)
    state.time = row.time
    age, table = state.age, state.table
    quiet = ends_second and _quiet(table)
    if ends_second and not quiet:
        table[_SUMS:] = 0
    for cell in range(len(row.counts)):
        drifting = _drifts(settings, state, cell) if quiet else state.active[cell, _DRIFTING] != 0
        before = table[_LAST, cell]
        if row.valid[cell]:
            count = int(row.counts[cell])
            table[_LAST, cell] = count
            table[_SUMS, cell] += 1
            table[_SUMS + 1, cell] += count
            table[_SUMS + 2, cell] += count * count
            table[_SOUND + _DEAD, cell] = age
        dead = _lasts(table, _DEAD, cell, age, settings.after)
        within = settings.floor < table[_LAST, cell] < settings.ceiling
        if dead or within:
            table[_SOUND + _SATURATED, cell] = age
        overloaded = not within and table[_SOUND + _SATURATED, cell] > 0  # not so from the beginning
        if dead or overloaded or table[_LAST, cell] != before:
            table[_SOUND + _STUCK, cell] = age
        stuck = _lasts(table, _STUCK, cell, age, settings.after)
        saturated = _lasts(table, _SATURATED, cell, age, settings.after)
        now = dead, stuck, saturated, drifting
        for kind in range(4):
            if now[kind] != (state.active[cell, kind] != 0):
                state.active[cell, kind] = now[kind]
                state.changed[cell, kind] = 1
                state.changes += 1


def _give_fault(settings: Record, state: Record, out: Record) -> bool:
    if not state.changes:
        return False
    for cell in range(len(state.changed)):
        for kind in range(4):
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


def _quiet(table: Times) -> bool:
    """Return whether every cell was quiet in the second that ends, as in an unloaded fingertip."""
    for cell in range(table.shape[1]):
        readings, total, squares = table[_SUMS, cell], table[_SUMS + 1, cell], table[_SUMS + 2, cell]
        most = _QUIET * readings
        if readings >= _READINGS and readings * squares - total * total >= most * most:
            return False
    return True


def _drifts(settings: Record, state: Record, cell: int) -> bool:
    """End a quiet second: return whether its mean differs from the first, or as before if it has no mean."""
    table = state.table
    readings, total = table[_SUMS, cell], table[_SUMS + 1, cell]
    table[_SUMS, cell] = table[_SUMS + 1, cell] = table[_SUMS + 2, cell] = 0
    mean = total / max(readings, 1)
    if readings >= _READINGS and settings.floor < mean < settings.ceiling:
        if isnan(state.first[cell]):
            state.first[cell] = mean
        return bool(abs(mean - state.first[cell]) > settings.drift)
    return bool(state.active[cell, _DRIFTING] != 0)

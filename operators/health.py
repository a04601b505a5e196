"""Detection of faulty barometers."""

from dataclasses import dataclass, field
from enum import IntEnum
from math import inf, isnan
from typing import Final, TypeAlias

import numpy as np

from operators.batch import Codes, Counts, Faults, Flags, Reals, Times, Touch, Zeroed, ms, s
from operators.checks import check_above, check_at_least
from operators.errors import ParameterError
from operators.operator import Operator
from operators.row_loop import row_loop

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
      keep the quality `good`. Not detected in zeroed counts.
    - drifting: the mean of a quiet second differs by more than `drift` from that of the first quiet second.
      The seconds count from the first row. One is quiet if the standard deviation of every cell is below 1
      count, as in an unloaded fingertip but not in contact, where the arm vibrates. So the stream should
      start unloaded, and drift in contact or next to a noisy cell is not detected. A perfectly constant load
      is reported as drift; so is a cell at its floor in zeroed counts.

    All faults except drift end after `clear_after` without fault. A value above 0 merges the faults of a
    cell that is repeatedly pressed to the end of its range.

    Pauses of the stream count as 25 ms at most. Rows of equal time are ordered by cell, then kind.

    Args:
        dead_after: Time without answer, ns.
        stuck_after: Time without change, ns.
        saturated_after: Time at the end of the range, ns.
        clear_after: Time without fault that ends it, ns.
        floor: Highest saturated raw count at the low end; by default 1 % of full scale.
        ceiling: Lowest saturated raw count at the high end; by default 99 % of full scale.
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
    floor: int = 10
    ceiling: int = 1013
    drift: float = 30.0
    _state: Times = field(init=False, repr=False, compare=False)  # (10, cells), see `_examine`
    _active: Flags = field(init=False, repr=False, compare=False)  # (cells, 4) by kind
    _first: Reals = field(init=False, repr=False, compare=False)  # (cells,) mean of the first quiet second
    _clock: Times = field(init=False, repr=False, compare=False)  # ns: newest row, age, first row
    _limits: Times = field(init=False, repr=False, compare=False)  # ns

    def __post_init__(self) -> None:
        for name in ("dead_after", "stuck_after", "saturated_after"):
            check_above("Health", name, getattr(self, name), 0, "ns")
        check_above("Health", "drift", self.drift, 0, "counts")
        check_at_least("Health", "clear_after", self.clear_after, 0, "ns")
        if self.floor >= self.ceiling:
            raise ParameterError("Health", "floor", self.floor, f"below ceiling, {self.ceiling}")
        self._limits = np.array([self.dead_after, self.stuck_after, self.saturated_after, self.clear_after])
        self._set_up(np.zeros(0, np.int64), 0)

    def process(self, batch: Touch) -> Faults:
        """Return the faults that started or ended."""
        if not self._clock.size:
            self._set_up(np.array([batch.time[0], 0, batch.time[0]]), batch.counts.shape[1])
        scale = (-inf, inf) if isinstance(batch, Zeroed) else (float(self.floor), float(self.ceiling))
        limits = (*scale, float(self.drift))
        memory = self._state, self._active, self._first, self._clock
        changes = np.zeros((*batch.counts.shape, len(FaultKind)), np.int8)
        if not _examine(batch.time, batch.counts, batch.valid, memory, self._limits, limits, changes):
            return Faults.empty()
        row, cell, kind = np.nonzero(changes)
        active = changes[row, cell, kind] > 0
        kinds = cell.astype(np.int8), kind.astype(np.int8)
        return Faults(batch.time[row], *kinds, active, finger=batch.finger)

    def _set_up(self, clock: Times, cells: int) -> None:
        self._clock, self._first = clock, np.full(cells, np.nan)
        self._active = np.zeros((cells, len(FaultKind)), np.bool_)
        self._state = np.zeros((_SUMS + 3, cells), np.int64)
        self._state[_LAST] = (self.floor + self.ceiling) // 2
        self._state[_FAULTY:_SUMS] = -self.clear_after


# Rows of the state: last valid counts; age when last sound and when last faulty, by kind (dead, stuck,
# saturated); number, sum and sum of squares of the current second's readings.
_LAST, _SOUND, _FAULTY, _SUMS = 0, 1, 4, 7
_DEAD, _STUCK, _SATURATED, _DRIFTING = range(4)
Memory: TypeAlias = tuple[Times, Flags, Reals, Times]  # state, active, first, clock
Limits: TypeAlias = tuple[float, float, float]  # floor, ceiling, drift


@row_loop
def _examine(
    time: Times, counts: Counts, valid: Flags, /, memory: Memory, after: Times, limits: Limits, changes: Codes
) -> bool:
    """Mark starts (1) and ends (-1) of faults in (n, cells, 4) `changes`; return whether there are any."""
    state, active, _, clock = memory
    changed = False
    for row in range(len(time)):
        ends_second = (time[row] - clock[2]) // s != (clock[0] - clock[2]) // s
        clock[1] += min(time[row] - clock[0], _PAUSE)
        clock[0] = time[row]
        age = clock[1]
        quiet = ends_second and _quiet(state)
        if ends_second and not quiet:
            state[_SUMS:] = 0
        for cell in range(counts.shape[1]):
            drifting = _drifts(memory, cell, limits) if quiet else active[cell, _DRIFTING]
            before = state[_LAST, cell]
            if valid[row, cell]:
                count = int(counts[row, cell])
                state[_LAST, cell] = count
                state[_SUMS, cell] += 1
                state[_SUMS + 1, cell] += count
                state[_SUMS + 2, cell] += count * count
                state[_SOUND + _DEAD, cell] = age
            dead = _lasts(state, _DEAD, cell, age, after)
            within = limits[0] < state[_LAST, cell] < limits[1]
            if dead or within:
                state[_SOUND + _SATURATED, cell] = age
            overloaded = not within and state[_SOUND + _SATURATED, cell] > 0  # not so from the beginning
            if dead or overloaded or state[_LAST, cell] != before:
                state[_SOUND + _STUCK, cell] = age
            stuck = _lasts(state, _STUCK, cell, age, after)
            saturated = _lasts(state, _SATURATED, cell, age, after)
            now = dead, stuck, saturated, drifting
            for kind in range(4):
                if now[kind] != active[cell, kind]:
                    active[cell, kind] = now[kind]
                    changes[row, cell, kind] = 1 if now[kind] else -1
                    changed = True
    return changed


def _lasts(state: Times, kind: int, cell: int, age: int, after: Times) -> bool:
    """Return whether a cell has been faulty for the kind's time, now or within `clear_after`."""
    faulty: bool = age - state[_SOUND + kind, cell] >= after[kind]
    if faulty:
        state[_FAULTY + kind, cell] = age
    recently: bool = age - state[_FAULTY + kind, cell] < after[3]
    return faulty or recently


def _quiet(state: Times) -> bool:
    """Return whether every cell was quiet in the second that ends, as in an unloaded fingertip."""
    for cell in range(state.shape[1]):
        readings, total, squares = state[_SUMS, cell], state[_SUMS + 1, cell], state[_SUMS + 2, cell]
        most = _QUIET * readings
        if readings >= _READINGS and readings * squares - total * total >= most * most:
            return False
    return True


def _drifts(memory: Memory, cell: int, limits: Limits) -> bool:
    """End a quiet second: return whether its mean differs from the first, or as before if it has no mean."""
    state, active, first, _ = memory
    readings, total = state[_SUMS, cell], state[_SUMS + 1, cell]
    state[_SUMS, cell] = state[_SUMS + 1, cell] = state[_SUMS + 2, cell] = 0
    drifting: bool = active[cell, _DRIFTING]
    mean = total / max(readings, 1)
    if readings >= _READINGS and limits[0] < mean < limits[1]:
        if isnan(first[cell]):
            first[cell] = mean
        drifting = abs(mean - first[cell]) > limits[2]
    return drifting

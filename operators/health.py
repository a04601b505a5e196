"""Detection of faulty barometers."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np

from operators.batch import BAROMETERS, Counts, Faults, Flags, Reals, Times, Touch, Zeroed, ms, s
from operators.checks import check_above, check_at_least
from operators.errors import ParameterError
from operators.forward_fill import forward_fill
from operators.operator import Operator
from operators.tail import Tail

_PAUSE: Final = 25 * ms  # ns, longer pauses of the stream count as this long
_SPAN: Final = 200 * ms  # ns, span of rows that are examined together
_QUIET: Final = 1.5  # counts, standard deviation; 0.43 to 0.7 unloaded, 4 to 10 under a static load
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
      readings. A cell at the end of its range can be saturated and stuck.
    - saturated: raw counts at `floor` or below, or at `ceiling` or above, for `saturated_after`. Overload
      wraps from 0 to 1023, so both ends indicate it. Not detected in zeroed counts.
    - drifting: the mean of a quiet second differs by more than `drift` from that of the first quiet second. A
      second of event time is quiet if the standard deviation is below 1.5 counts, as in unloaded cells but
      not in contact. So the stream should start unloaded, and drift in contact is not detected. A perfectly
      constant load is reported as drift; so is a cell at its floor in zeroed counts.

    All faults except drift end after `clear_after` without fault. A value above 0 merges the faults of a
    cell that is repeatedly pressed to the end of its range.

    Pauses of the stream count as 25 ms at most. Faults are reported up to 200 ms late, since rows are
    examined in blocks of that length. Rows of equal time are ordered by cell, then kind.

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
    _waiting: Tail[Touch] = field(default_factory=lambda: Tail(Touch), init=False, repr=False, compare=False)
    _raw: bool = field(default=True, init=False, repr=False)
    _time: int | None = field(default=None, init=False, repr=False)  # ns, newest examined row
    _age: int = field(default=0, init=False, repr=False)  # ns, age of the stream without its pauses
    _last: Counts = field(init=False, repr=False, compare=False)  # (6,) last valid counts
    _sound: Times = field(init=False, repr=False, compare=False)  # (3, 6) age when last sound, by kind
    _faulty: Times = field(init=False, repr=False, compare=False)  # (3, 6) age when last faulty, by kind
    _active: Flags = field(init=False, repr=False, compare=False)  # (6, 4) by cell and kind
    _sums: Times = field(init=False, repr=False, compare=False)  # (3, 6) count, sum and sum of squares
    _first: Reals = field(init=False, repr=False, compare=False)  # (6,) mean of the first quiet second

    def __post_init__(self) -> None:
        for name in ("dead_after", "stuck_after", "saturated_after"):
            check_above("Health", name, getattr(self, name), 0, "ns")
        check_above("Health", "drift", self.drift, 0, "counts")
        check_at_least("Health", "clear_after", self.clear_after, 0, "ns")
        if self.floor >= self.ceiling:
            raise ParameterError("Health", "floor", self.floor, f"below ceiling, {self.ceiling}")
        self._last = np.full(BAROMETERS, (self.floor + self.ceiling) // 2, np.int16)
        self._sound = np.zeros((3, BAROMETERS), np.int64)
        self._faulty = np.full((3, BAROMETERS), -self.clear_after, np.int64)  # none yet
        self._active = np.zeros((BAROMETERS, len(FaultKind)), np.bool_)
        self._sums = np.zeros((3, BAROMETERS), np.int64)
        self._first = np.full(BAROMETERS, np.nan)

    def process(self, batch: Touch) -> Faults:
        """Return the faults that started or ended in the examined rows."""
        self._raw = not isinstance(batch, Zeroed)
        waiting = self._waiting
        if not len(waiting) and batch.time.item(-1) - batch.time.item(0) >= _SPAN:
            return self._examine(batch)
        waiting.append(batch)
        if batch.time.item(-1) - waiting.time.item(0) < _SPAN:
            return Faults.empty()
        return self.flush()

    def flush(self) -> Faults:
        """Return the faults in the rows not yet examined."""
        rows = self._waiting.rows
        if not len(rows):
            return Faults.empty()
        self._waiting.drop(len(rows))
        return self._examine(rows)

    def _examine(self, rows: Touch) -> Faults:
        time, counts, valid = rows.time, rows.counts, rows.valid
        before = time[:1] if self._time is None else [self._time]
        age = self._age + np.minimum(np.diff(time, prepend=before), _PAUSE).cumsum()[:, None]  # (n, 1)
        readings = forward_fill(counts, valid, self._last)  # (n, 6)
        changes = np.diff(readings, axis=0, prepend=self._last[None]) != 0
        dead = self._lasting(FaultKind.DEAD, valid, age, self.dead_after)
        stuck = self._lasting(FaultKind.STUCK, changes | dead, age, self.stuck_after)
        inside = (readings > self.floor) & (readings < self.ceiling) if self._raw else np.ones_like(valid)
        saturated = self._lasting(FaultKind.SATURATED, inside | dead, age, self.saturated_after)
        drifting = self._drifting(time, counts, valid)
        active = np.stack((dead, stuck, saturated, drifting), axis=2)  # (n, 6, 4)
        changed = np.diff(active, axis=0, prepend=self._active[None])
        self._time, self._age = time.item(-1), age.item(-1)
        self._last, self._active = readings[-1], active[-1]
        row, cell, kind = np.unravel_index(np.flatnonzero(changed), changed.shape)
        return Faults(
            time[row], cell.astype(np.int8), kind.astype(np.int8), active[row, cell, kind], finger=rows.finger
        )

    def _lasting(self, kind: FaultKind, sound: Flags, age: Times, after: int) -> Flags:
        """Return True where a cell has been faulty for `after`, now or within `clear_after`; (n, 6)."""
        seen = np.maximum.accumulate(np.where(sound, age, self._sound[kind]), axis=0)
        self._sound[kind] = seen[-1]
        faulty = age - seen >= after  # (n, 6)
        last = np.maximum.accumulate(np.where(faulty, age, self._faulty[kind]), axis=0)
        self._faulty[kind] = last[-1]
        return faulty | (age - last < self.clear_after)

    def _drifting(self, time: Times, counts: Counts, valid: Flags) -> Flags:
        """Return True where the last quiet second of a cell differs from its first; (n, 6)."""
        second = time // s
        before = second[:1] if self._time is None else [self._time // s]
        begun = np.flatnonzero(np.diff(second, prepend=before))  # (k,) first row of each later second
        bounds = np.concatenate(([0], begun, [len(time)]))
        known = np.where(valid, counts, 0).astype(np.int64)
        sums = np.stack((valid, known, known * known), axis=1).cumsum(axis=0)  # (n, 3, 6)
        sums = np.diff(np.concatenate((np.zeros_like(sums[:1]), sums))[bounds], axis=0)  # (k + 1, 3, 6)
        sums[0] += self._sums
        self._sums = sums[-1]
        state = self._compare(sums[:-1], self._active[:, FaultKind.DRIFTING])  # (k + 1, 6)
        return np.repeat(state, np.diff(bounds), axis=0)

    def _compare(self, sums: Times, state: Flags) -> Flags:
        """Return the drift state before and after each of k complete seconds; (k + 1, 6)."""
        readings, total, squares = sums.swapaxes(0, 1)  # (k, 6)
        mean = total / np.maximum(readings, 1)
        quiet = (readings >= _READINGS) & (readings * squares - total**2 < (_QUIET * readings) ** 2)
        if self._raw:
            quiet &= (mean > self.floor) & (mean < self.ceiling)
        if len(quiet):
            first = np.take_along_axis(mean, quiet.argmax(axis=0)[None], axis=0)[0]
            self._first = np.where(quiet.any(axis=0) & np.isnan(self._first), first, self._first)
        return np.concatenate(
            (state[None], forward_fill(np.abs(mean - self._first) > self.drift, quiet, state))
        )

"""Barometers that cannot be trusted."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np

from operators.batch import BAROMETERS, Counts, Faults, Flags, Reals, Times, Touch, Zeroed, ms, s
from operators.errors import ParameterError
from operators.forward_fill import forward_fill
from operators.operator import Operator
from operators.tail import Tail

_PAUSE: Final = 25 * ms  # a longer pause of the stream counts as this long
_SPAN: Final = 200 * ms  # of rows examined together
_QUIET: Final = 1.5  # counts, standard deviation; 0.43 to 0.7 unloaded, 4 to 10 under a static load
_READINGS: Final = 10  # that a second must have to be called quiet


class FaultKind(IntEnum):
    """What is wrong with a barometer."""

    DEAD = 0
    STUCK = 1
    SATURATED = 2
    DRIFTING = 3


@dataclass
class Health(Operator[Touch, Faults]):
    """Tell when a barometer's fault begins and ends; of one instant in the order of cells, then kinds.

    - dead: no answer for `dead_after`. A cell that answers now and then is not dead.
    - stuck: its valid counts have not changed for `stuck_after`. Noise alone moves a sound cell by a count
      within a few readings; a cell pinned at the end of its range may be saturated and stuck.
    - saturated: raw counts at `floor` or below, or at `ceiling` or above, for `saturated_after`. Overload
      wraps from 0 to 1023, so both ends mean it. Zeroed counts do not show it.
    - drifting: the mean of a quiet second is more than `drift` from that of the first quiet one. A second
      (of event time) is quiet if the counts spread by less than 1.5, as unloaded cells do and contact does
      not. So the stream should begin unloaded, drift while in contact is not seen, and a load that is
      perfectly still is taken for drift; so is a cell at its floor in zeroed counts, not in raw ones.

    A fault but drift ends once the cell was sound for `clear_after`. Above 0, that makes one fault of many
    where a cell is pressed to the end of its range again and again.

    Where the stream pauses nothing is known: a pause counts as 25 ms at most. Faults are told up to 200 ms
    after their time, because rows are examined that many at once.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    dead_after: int = 500 * ms
    stuck_after: int = 2 * s
    saturated_after: int = 50 * ms
    clear_after: int = 0
    floor: int = 10  # raw count, 1 % of full scale
    ceiling: int = 1013  # raw count
    drift: float = 30.0  # counts
    _waiting: Tail[Touch] = field(default_factory=lambda: Tail(Touch), init=False, repr=False, compare=False)
    _raw: bool = field(default=True, init=False, repr=False)
    _time: int | None = field(default=None, init=False, repr=False)  # ns, of the newest row examined
    _age: int = field(default=0, init=False, repr=False)  # ns, of the stream without its pauses
    _last: Counts = field(init=False, repr=False, compare=False)  # (6,) last valid
    _sound: Times = field(init=False, repr=False, compare=False)  # (3, 6) age when last seen sound, by kind
    _faulty: Times = field(init=False, repr=False, compare=False)  # (3, 6) age when last at fault, by kind
    _active: Flags = field(init=False, repr=False, compare=False)  # (6, 4) by cell and kind
    _sums: Times = field(init=False, repr=False, compare=False)  # (3, 6) readings, their sum, their squares
    _first: Reals = field(init=False, repr=False, compare=False)  # (6,) mean of the first quiet second

    def __post_init__(self) -> None:
        spans = (("dead_after", "ns"), ("stuck_after", "ns"), ("saturated_after", "ns"))
        for name, unit in (*spans, ("drift", "counts")):
            if getattr(self, name) <= 0:
                raise ParameterError("Health", name, getattr(self, name), f"above 0 {unit}")
        if self.clear_after < 0:
            raise ParameterError("Health", "clear_after", self.clear_after, "at least 0 ns")
        if self.floor >= self.ceiling:
            raise ParameterError("Health", "floor", self.floor, f"below the ceiling, {self.ceiling}")
        self._last = np.full(BAROMETERS, (self.floor + self.ceiling) // 2, np.int16)
        self._sound = np.zeros((3, BAROMETERS), np.int64)
        self._faulty = np.full((3, BAROMETERS), -self.clear_after, np.int64)  # never yet
        self._active = np.zeros((BAROMETERS, len(FaultKind)), np.bool_)
        self._sums = np.zeros((3, BAROMETERS), np.int64)
        self._first = np.full(BAROMETERS, np.nan)

    def process(self, batch: Touch) -> Faults:
        """Give the faults that began or ended in the rows examined."""
        self._raw = not isinstance(batch, Zeroed)
        waiting = self._waiting
        if not len(waiting) and batch.time.item(-1) - batch.time.item(0) >= _SPAN:
            return self._examine(batch)
        waiting.append(batch)
        if batch.time.item(-1) - waiting.time.item(0) < _SPAN:
            return Faults.empty()
        return self.flush()

    def flush(self) -> Faults:
        """Give what the rows not yet examined show."""
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
        """Where a cell has not been seen sound for `after`, or was so `clear_after` ago; (n, 6)."""
        seen = np.maximum.accumulate(np.where(sound, age, self._sound[kind]), axis=0)
        self._sound[kind] = seen[-1]
        faulty = age - seen >= after  # (n, 6)
        last = np.maximum.accumulate(np.where(faulty, age, self._faulty[kind]), axis=0)
        self._faulty[kind] = last[-1]
        return faulty | (age - last < self.clear_after)

    def _drifting(self, time: Times, counts: Counts, valid: Flags) -> Flags:
        """Where the last quiet second of a cell lies off its first; (n, 6)."""
        second = time // s
        before = second[:1] if self._time is None else [self._time // s]
        begun = np.flatnonzero(np.diff(second, prepend=before))  # (k,) rows that begin another second
        bounds = np.concatenate(([0], begun, [len(time)]))
        known = np.where(valid, counts, 0).astype(np.int64)
        sums = np.stack((valid, known, known * known), axis=1).cumsum(axis=0)  # (n, 3, 6)
        sums = np.diff(np.concatenate((np.zeros_like(sums[:1]), sums))[bounds], axis=0)  # (k + 1, 3, 6)
        sums[0] += self._sums
        self._sums = sums[-1]
        state = self._judge(sums[:-1], self._active[:, FaultKind.DRIFTING])  # (k + 1, 6)
        return np.repeat(state, np.diff(bounds), axis=0)

    def _judge(self, sums: Times, state: Flags) -> Flags:
        """The state at hand, and after each complete second; (k + 1, 6)."""
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

"""Alignment of the arm's motion with the touch samples."""

from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any, Final, Literal, get_args

import numpy as np

from operators.batch import Flags, Motion, Reals, Sample, Times, Zeroed, ms, s
from operators.checks import check_at_least, check_choice
from operators.operator import Join
from operators.row_loop import row_loop
from operators.row_queues import END, Chain

How = Literal["nearest", "previous"]

_ROWS: Final = 1024  # of motion, smallest size of the arrays
_NEAREST: Final = 0  # index of `How`


@dataclass
class Align(Join[Zeroed, Motion, Sample]):
    """Join each zeroed touch sample with the arm's motion at its time t.

    `how` selects the motion:

    - ``previous``: the last row up to t;
    - ``nearest``: the last row up to t or the first one after t, whichever is nearer; the later one in a tie.

    Motion further from t than `within` is ignored, as is motion whose velocity is not finite. Touch samples
    without motion are kept: velocity and pose are NaN and `matched` is False.

    A touch sample is released when motion newer than t has arrived, when the touch stream is `wait` past t,
    or when it ends. The result is exact if motion lags touch by at most `wait` (for nearest, which looks
    ahead, `wait` - `within`) and touch lags motion by at most `keep`. With ``how="previous"`` and ``wait=0``
    no sample is delayed.

    Args:
        within: Largest distance of motion from t, ns.
        how: Selection of the motion.
        wait: Longest time that a touch sample waits for motion, ns; at least `within`, except for previous.
        keep: Time for which motion is kept, ns; must cover the delay of touch while `Zero` measures.

    Raises:
        ParameterError: if a parameter is invalid.

    >>> zeroed = Zeroed(np.array([10 * ms]), *np.zeros((2, 1, 6), np.int16), np.ones((1, 6), bool))
    >>> motion = Motion(np.array([8 * ms, 16 * ms]), np.zeros(2, int), np.ones((2, 6)), np.zeros((2, 6)))
    >>> Align().push(zeroed, motion).matched
    array([ True])
    """

    within: int = 20 * ms
    how: How = "nearest"
    wait: int = 100 * ms
    keep: int = 10 * s
    _stamps: Times = field(init=False, repr=False, compare=False)  # of the motion kept, ns
    _values: Reals = field(init=False, repr=False, compare=False)  # (n, 12) velocity and pose
    # start and stop of the motion kept in these arrays; `within`, longest distance from the newest, `how`
    _state: Times = field(init=False, repr=False, compare=False)
    _free: int = field(default=0, init=False, repr=False)  # rows for which there certainly is room
    _newest: int = field(default=-END, init=False, repr=False)  # ns, newest motion
    _touched: int = field(default=-END, init=False, repr=False)  # ns, newest touch
    _held: Chain[Zeroed] = field(default_factory=lambda: Chain(Zeroed), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_choice("Align", "how", self.how, get_args(How))
        check_at_least("Align", "within", self.within, 0, "ns")
        check_at_least("Align", "keep", self.keep, 0, "ns")
        check_at_least("Align", "wait", self.wait, 0 if self.how == "previous" else self.within, "ns")
        self._stamps, self._values = np.empty(0, np.int64), np.empty((0, 12))
        self._state = np.array([0, 0, self.within, self.keep + self.within, get_args(How).index(self.how)])

    def process(self, left: Zeroed, right: Motion) -> Sample:
        """Store the motion, then return the touch samples that can be matched."""
        oldest = self._newest - self.keep  # ns, oldest touch that still has all its motion
        if right.time.size:
            self._store(right)
        if left.time.size:
            self._held.append(left)
            self._touched = left.time.item(-1)
        # touch up to `wait` before the newest one has waited long enough
        rows = self._held.take(max(self._newest, self._touched - self.wait + 1))
        return self._match(rows, oldest) if rows.time.size else Sample.empty()

    def flush(self) -> Sample:
        """Return the held touch samples, matched with the motion so far."""
        rows = self._held.take()
        return self._match(rows, -END) if rows.time.size else Sample.empty()

    def _store(self, motion: Motion) -> None:
        self._free -= motion.time.size
        if self._free < 0:
            start, stop = self._state[:2].tolist()
            self._resize(max(_ROWS, 2 * (stop - start) + motion.time.size))
            self._free -= motion.time.size
        values = motion.velocity, motion.pose
        self._newest = _keep(motion.time, *values, self._stamps, self._values, self._state, self._newest)

    def _resize(self, size: int) -> None:
        """Move the motion kept to new arrays with room for `size` rows."""
        start, stop = self._state[:2].tolist()
        stamps, values = np.empty(size, np.int64), np.empty((size, 12))
        stamps[: stop - start], values[: stop - start] = self._stamps[start:stop], self._values[start:stop]
        self._stamps, self._values = stamps, values
        self._state[:2] = 0, stop - start
        self._free = size - (stop - start)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without motion that is too old."""
        start, stop = self._state[:2].tolist()
        oldest = self._newest - self.keep - self.within
        self._state[0] = start + int(self._stamps[start:stop].searchsorted(oldest))
        self._resize(stop - int(self._state[0]))
        return vars(self)

    def _match(self, rows: Zeroed, oldest: int) -> Sample:
        size = rows.time.size
        velocity, pose, matched = np.empty((size, 6)), np.empty((size, 6)), np.empty(size, np.bool_)
        _match(rows.time, self._stamps, self._values, self._state, oldest, velocity, pose, matched)
        return Sample(  # without *, which takes 0.2 us
            rows.time,
            rows.counts,
            rows.temperature,
            rows.valid,
            velocity,
            pose,
            matched,
            finger=rows.finger,
        )


@row_loop
def _keep(
    time: Times, velocity: Reals, pose: Reals, /, stamps: Times, values: Reals, state: Times, newest: int
) -> int:
    """Drop old rows, then store those with finite velocity; return the newest time."""
    start, stop = int(state[0]), int(state[1])
    while start < stop and stamps[start] < newest - state[3]:
        start += 1
    for row in range(len(time)):
        finite = True
        for axis in range(6):
            values[stop, axis], values[stop, 6 + axis] = velocity[row, axis], pose[row, axis]
            finite = finite and isfinite(velocity[row, axis])
        if finite:
            stamps[stop] = newest = int(time[row])
            stop += 1
    state[0], state[1] = start, stop
    return newest


@row_loop
def _match(
    time: Times,
    /,
    stamps: Times,
    values: Reals,
    state: Times,
    oldest: int,
    velocity: Reals,
    pose: Reals,
    matched: Flags,
) -> None:
    """Select the motion of each row."""
    start, stop, within, how = int(state[0]), int(state[1]), int(state[2]), int(state[4])
    after = stop  # index of the first motion after the row
    while after > start and stamps[after - 1] > time[0]:
        after -= 1
    for row in range(len(time)):
        instant = time[row]
        while after < stop and stamps[after] <= instant:
            after += 1
        since = instant - stamps[after - 1] if after > start else END
        ahead = stamps[after] - instant if after < stop else END
        source, distance = after - 1, since
        if how == _NEAREST and ahead <= since:
            source, distance = after, ahead
        matched[row] = distance <= within and instant >= oldest
        if not matched[row]:
            for axis in range(6):
                velocity[row, axis] = pose[row, axis] = nan
        else:
            for axis in range(6):
                velocity[row, axis], pose[row, axis] = values[source, axis], values[source, 6 + axis]

"""Alignment of the arm's motion with the touch samples."""

from dataclasses import dataclass
from math import isfinite, nan
from typing import Final, Literal, get_args

from operators.batch import Motion, Sample, Zeroed, ms, s
from operators.checks import check_at_least, check_choice
from operators.operator import Join
from operators.steps import END, Record, RowType, Steps, copy, queue

How = Literal["nearest", "previous"]

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
    ahead, `wait` - `within`) and touch lags motion by at most `keep`, for streams of up to 1 kHz: rows of
    faster ones are released or forgotten earlier. With ``how="previous"`` and ``wait=0`` no sample is
    delayed.

    Args:
        within: Largest distance of motion from t, ns.
        how: Selection of the motion.
        wait: Longest time that a touch sample waits for motion, ns; at least `within`, except for previous.
        keep: Time for which motion is kept, ns; must cover the delay of touch while `Zero` measures, which is
            20 s at 5 Hz.

    Raises:
        ParameterError: if a parameter is invalid.

    >>> import numpy as np
    >>> zeroed = Zeroed(np.array([10 * ms]), *np.zeros((2, 1, 6), np.int16), np.ones((1, 6), bool))
    >>> motion = Motion(np.array([8 * ms, 16 * ms]), np.zeros(2, int), np.ones((2, 6)), np.zeros((2, 6)))
    >>> Align().push(zeroed, motion).matched
    array([ True])
    """

    within: int = 20 * ms
    how: How = "nearest"
    wait: int = 100 * ms
    keep: int = 25 * s

    def __post_init__(self) -> None:
        check_choice("Align", "how", self.how, get_args(How))
        check_at_least("Align", "within", self.within, 0, "ns")
        check_at_least("Align", "keep", self.keep, 0, "ns")
        check_at_least("Align", "wait", self.wait, 0 if self.how == "previous" else self.within, "ns")

    def steps(self, *given: RowType) -> Steps:
        """Return the functions that take touch and motion, and give samples."""
        held = queue(given[0], self.wait)
        return Steps(
            settings={
                "within": self.within,
                "wait": self.wait,
                "keep": self.keep,
                "how": get_args(How).index(self.how),
            },
            state={
                "held": held,  # touch that waits
                "first": 0,  # number of the oldest row that waits
                "last": 0,  # number after the newest one
                "motion": queue(RowType(Motion), self.keep),
                "start": 0,  # number of the oldest motion kept
                "stop": 0,  # number after the newest one
                "newest": -END,  # ns, motion
                "touched": -END,  # ns, newest touch
                "oldest": -END,  # ns, oldest touch that still has all its motion
                "ended": 0,
            },
            takes=(_take_touch, _take_motion),
            give=_give_sample,
            held=len(held),
        )


def _take_touch(settings: Record, state: Record, row: Record) -> None:
    copy(state.held[state.last % len(state.held)], row)
    state.last += 1
    state.touched = row.time
    state.oldest = state.newest - settings.keep


def _take_motion(settings: Record, state: Record, row: Record) -> None:
    state.oldest = state.newest - settings.keep
    for axis in range(6):
        if not isfinite(row.velocity[axis]):
            return
    if state.stop - state.start == len(state.motion):
        state.start += 1
    copy(state.motion[state.stop % len(state.motion)], row)
    state.stop += 1
    state.newest = row.time


def _give_sample(settings: Record, state: Record, out: Record) -> bool:
    """Match the oldest touch that has waited long enough with the motion at its time."""
    if state.first == state.last:
        return False
    row = state.held[state.first % len(state.held)]
    instant = row.time
    full = state.last - state.first == len(state.held)
    if instant >= max(state.newest, state.touched - settings.wait + 1) and not (state.ended or full):
        return False
    copy(out, row)
    state.first += 1
    after, kept = state.stop, len(state.motion)  # number of the first motion after the row
    while after > state.start and state.motion[(after - 1) % kept].time > instant:
        after -= 1
    source, distance = after - 1, END
    if after > state.start:
        distance = instant - state.motion[source % kept].time
    if settings.how == _NEAREST and after < state.stop:
        ahead = state.motion[after % kept].time - instant
        if ahead <= distance:
            source, distance = after, ahead
    matched = distance <= settings.within and (state.ended or instant >= state.oldest)
    out.matched = matched
    motion = state.motion[source % kept]
    for axis in range(6):
        out.velocity[axis] = motion.velocity[axis] if matched else nan
        out.pose[axis] = motion.pose[axis] if matched else nan
    return True

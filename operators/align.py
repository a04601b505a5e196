"""The arm's motion at the instant of each touch."""

from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Final, Literal, get_args

import numpy as np

from operators.batch import Flags, Motion, Reals, Sample, Zeroed, constant, maker, ms, s
from operators.chain import Chain
from operators.errors import ParameterError
from operators.operator import Join
from operators.rotation import Real, between

How = Literal["nearest", "previous", "linear"]

_FAR: Final = 2**62  # ns, further than any two stamps lie apart
_made: Final = maker(Sample)
_MATCHED: Final = constant([True])  # (1,)
_UNMATCHED: Final = constant([False])  # (1,)
_NO_MOTION: Final = constant([[nan] * 6])  # (1, 6)


@dataclass
class Align(Join[Zeroed, Motion, Sample]):
    """Join by event time: give each touch, at t, the motion of that instant.

    By `how`, that is the motion of

    - ``previous``: the last row up to t;
    - ``nearest``: that or the first row after t, whichever is nearer; at a tie the later;
    - ``linear``: the row at t, or between those two, in proportion; rotations at constant rate.

    Of several rows with one stamp, the one next to the other side of t is meant: the last up to t, the
    first after. Rows further from t than `within` do not count, nor do rows whose velocity is not finite.
    A touch without motion is kept: its velocity and pose are NaN and `matched` is False.

    A touch is decided when motion newer than t has come, or with what is there when the touch stream has
    gone on by `wait` or has ended. So `wait` is the most that missing motion delays a touch. Motion is kept
    for `keep`: a touch that comes later than motion newer than t + `keep` finds no match.

    The result is the ideal join as long as touch lags motion by `keep` at most, and motion lags touch by
    `wait` at most, or `wait` - `within` for nearest and linear, which look ahead. With ``wait=0`` and
    ``how="previous"`` every touch is decided at once.

    Raises:
        ParameterError: on a value that cannot be used; `wait` is at least `within`, but for previous.
    """

    within: int = 20 * ms  # ns
    how: How = "nearest"
    wait: int = 100 * ms  # ns, for motion
    keep: int = 10 * s  # ns, motion; more than touch may lag, as it does while `Zero` takes its baseline
    _motion: Chain[Motion] = field(
        default_factory=lambda: Chain(Motion), init=False, repr=False, compare=False
    )
    _newest: int = field(default=-_FAR, init=False, repr=False)  # ns, of the motion
    _held: Chain[Zeroed] = field(default_factory=lambda: Chain(Zeroed), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.how not in get_args(How):
            raise ParameterError("Align", "how", self.how, "nearest, previous or linear")
        for name in ("within", "keep"):
            if getattr(self, name) < 0:
                raise ParameterError("Align", name, getattr(self, name), "at least 0 ns")
        least = 0 if self.how == "previous" else self.within
        if self.wait < least:
            raise ParameterError(
                "Align", "wait", self.wait, f"at least {least} ns, to see the rows after a touch"
            )

    def process(self, left: Zeroed, right: Motion) -> Sample:
        """Take motion first, then touch; give the touch rows that are decided."""
        oldest = self._newest - self.keep  # that a new touch may be
        if right.time.size:
            self._remember(right)
        if left.time.size:
            self._held.append(left)
        passed = self._order_left.newest - self.wait  # touch up to here has waited long enough
        rows = self._held.take(max(self._newest, passed + 1))
        samples = Sample.empty() if rows is None else self._match(rows, oldest)
        if right.time.size:
            # not at every row, which is slow
            self._motion.forget(self._newest - self.keep - self.within, self.keep // 8)
        return samples

    def flush(self) -> Sample:
        """Give the touch rows that still wait, with what is there."""
        rows = self._held.take(_FAR)
        return Sample.empty() if rows is None else self._match(rows, -_FAR)

    def _remember(self, motion: Motion) -> None:
        if motion.time.size == 1:
            [velocity] = motion.velocity.tolist()
            kept = isfinite(sum(velocity)) or all(map(isfinite, velocity))  # a sum may overflow
        else:
            rows = np.all(np.isfinite(motion.velocity), axis=1)  # (n,)
            motion = motion if np.all(rows) else motion[rows]
            kept = motion.time.size > 0
        if kept:
            self._motion.append(motion)
            self._newest = motion.time.item(-1)

    def _match(self, rows: Zeroed, oldest: int) -> Sample:
        if rows.time.size == 1:
            return self._match_one(rows, oldest)
        motion = self._motion.over(rows.time.item(0), rows.time.item(-1))
        time = motion.time
        after = time.searchsorted(rows.time, "right")  # (n,) the first newer row
        around = np.concatenate(([-_FAR], time, [_FAR]))
        behind, ahead = rows.time - around[after], around[after + 1] - rows.time  # (n,) ns
        if self.how == "previous":
            matched = behind <= self.within
        elif self.how == "nearest":
            matched = np.minimum(behind, ahead) <= self.within
            after += ahead <= behind
        else:
            matched = (behind == 0) | (np.maximum(behind, ahead) <= self.within)
        matched &= rows.time >= oldest
        after -= 1
        if matched.all():
            velocity, pose = motion.velocity.take(after, axis=0), motion.pose.take(after, axis=0)
        else:
            velocity, pose = np.full((len(rows), 6), np.nan), np.full((len(rows), 6), np.nan)
            source = after[matched]
            velocity[matched], pose[matched] = motion.velocity[source], motion.pose[source]
        if self.how == "linear":
            inside = matched & (behind > 0)
            source = after[inside] + 1
            part = behind[inside] / (behind + ahead)[inside]  # (m,)
            with np.errstate(invalid="ignore"):  # what is infinite becomes NaN
                moved = _moved(list(velocity[inside].T), list(motion.velocity[source].T), part)
                posed = _posed(list(pose[inside].T), list(motion.pose[source].T), part)
            velocity[inside], pose[inside] = np.transpose(moved), np.transpose(posed)
        return _sample(rows, velocity, pose, matched)

    def _match_one(self, rows: Zeroed, oldest: int) -> Sample:
        instant = rows.time.item(0)
        before, after = self._motion.around(instant)
        behind = instant - before.time.item(0) if before is not None else _FAR
        ahead = after.time.item(0) - instant if after is not None else _FAR
        motion, off = before, behind
        if self.how == "nearest" and ahead <= behind:
            motion, off = after, ahead
        elif self.how == "linear" and behind:
            off = max(behind, ahead)
        if motion is None or off > self.within or instant < oldest:
            return _sample(rows, _NO_MOTION, _NO_MOTION, _UNMATCHED)
        velocity, pose = motion.velocity, motion.pose
        if self.how == "linear" and behind and after is not None:
            part = behind / (behind + ahead)
            with np.errstate(invalid="ignore"):
                moved = _moved(velocity[0].tolist(), after.velocity[0].tolist(), part)
                posed = _posed(pose[0].tolist(), after.pose[0].tolist(), part)
            velocity, pose = np.array([moved]), np.array([posed])
        return _sample(rows, velocity, pose, _MATCHED)


def _moved(first: list[Real], second: list[Real], part: Real) -> list[Real]:
    """Components on the straight way from one to another."""
    return [a + part * (b - a) for a, b in zip(first, second, strict=True)]


def _posed(first: list[Real], second: list[Real], part: Real) -> list[Real]:
    """Components of a pose between two: the place moves straight, the rotation turns evenly."""
    x, y, z = _moved(first[:3], second[:3], part)
    u, v, w = between((first[3], first[4], first[5]), (second[3], second[4], second[5]), part)
    return [x, y, z, u, v, w]


def _sample(rows: Zeroed, velocity: Reals, pose: Reals, matched: Flags) -> Sample:
    return _made(rows.time, rows.counts, rows.temperature, rows.valid, velocity, pose, matched, rows.finger)

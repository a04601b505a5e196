"""Alignment of the arm's motion with the touch samples."""

from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Final, Literal, get_args

import numpy as np

from operators.batch import Flags, Motion, Reals, Sample, Zeroed, constant, ms, s
from operators.chain import Chain
from operators.checks import check_at_least, check_choice
from operators.operator import Join
from operators.rotation import Real, interpolate_rotation

How = Literal["nearest", "previous", "linear"]

_FAR: Final = 2**62  # ns, exceeds the distance between any two stamps
_MATCHED: Final = constant([True])  # (1,)
_UNMATCHED: Final = constant([False])  # (1,)
_NO_MOTION: Final = constant([[nan] * 6])  # (1, 6)


@dataclass
class Align(Join[Zeroed, Motion, Sample]):
    """Join each zeroed touch sample with the arm's motion at its time t.

    `how` selects the motion:

    - ``previous``: the last row up to t;
    - ``nearest``: the last row up to t or the first one after t, whichever is nearer; the later one in a tie;
    - ``linear``: interpolation between these two; rotations at constant rate.

    Motion further from t than `within` is ignored, as is motion whose velocity is not finite. Touch samples
    without motion are kept: velocity and pose are NaN and `matched` is False.

    A touch sample is released when motion newer than t has arrived, when the touch stream is `wait` past t,
    or when it ends. The result is exact if motion lags touch by at most `wait` (`wait` - `within` for nearest
    and linear, which look ahead) and touch lags motion by at most `keep`. With ``how="previous"`` and
    ``wait=0`` no sample is delayed.

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
    _motion: Chain[Motion] = field(
        default_factory=lambda: Chain(Motion), init=False, repr=False, compare=False
    )
    _newest: int = field(default=-_FAR, init=False, repr=False)  # ns, newest motion
    _held: Chain[Zeroed] = field(default_factory=lambda: Chain(Zeroed), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_choice("Align", "how", self.how, get_args(How))
        check_at_least("Align", "within", self.within, 0, "ns")
        check_at_least("Align", "keep", self.keep, 0, "ns")
        check_at_least("Align", "wait", self.wait, 0 if self.how == "previous" else self.within, "ns")

    def process(self, left: Zeroed, right: Motion) -> Sample:
        """Store the motion, then return the touch samples that can be matched."""
        oldest = self._newest - self.keep  # ns, oldest touch that still has all its motion
        if right.time.size:
            self._store(right)
        if left.time.size:
            self._held.append(left)
        passed = self._late_left.newest - self.wait  # ns, touch up to this time has waited long enough
        rows = self._held.take(max(self._newest, passed + 1))
        samples = Sample.empty() if rows is None else self._match(rows, oldest)
        if right.time.size:
            # drop many rows at once: dropping single rows is slow
            self._motion.forget(self._newest - self.keep - self.within, self.keep // 8)
        return samples

    def flush(self) -> Sample:
        """Return the held touch samples, matched with the motion so far."""
        rows = self._held.take(_FAR)
        return Sample.empty() if rows is None else self._match(rows, -_FAR)

    def _store(self, motion: Motion) -> None:
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
        after = time.searchsorted(rows.time, "right")  # (n,) index of the first newer row
        around = np.concatenate(([-_FAR], time, [_FAR]))
        since, ahead = rows.time - around[after], around[after + 1] - rows.time  # (n,) ns
        if self.how == "previous":
            matched = since <= self.within
        elif self.how == "nearest":
            matched = np.minimum(since, ahead) <= self.within
            after += ahead <= since
        else:
            matched = (since == 0) | (np.maximum(since, ahead) <= self.within)
        matched &= rows.time >= oldest
        after -= 1
        if matched.all():
            velocity, pose = motion.velocity.take(after, axis=0), motion.pose.take(after, axis=0)
        else:
            velocity, pose = np.full((len(rows), 6), np.nan), np.full((len(rows), 6), np.nan)
            source = after[matched]
            velocity[matched], pose[matched] = motion.velocity[source], motion.pose[source]
        if self.how == "linear":
            inside = matched & (since > 0)
            source = after[inside] + 1
            fraction = since[inside] / (since + ahead)[inside]  # (m,)
            with np.errstate(invalid="ignore"):  # infinite values become NaN
                linear = _interpolate(list(velocity[inside].T), list(motion.velocity[source].T), fraction)
                pose_rows = _interpolate_pose(list(pose[inside].T), list(motion.pose[source].T), fraction)
            velocity[inside], pose[inside] = np.transpose(linear), np.transpose(pose_rows)
        return _sample(rows, velocity, pose, matched)

    def _match_one(self, rows: Zeroed, oldest: int) -> Sample:
        instant = rows.time.item(0)
        before, after = self._motion.around(instant)
        since = instant - before.time.item(0) if before is not None else _FAR
        ahead = after.time.item(0) - instant if after is not None else _FAR
        motion, distance = before, since
        if self.how == "nearest" and ahead <= since:
            motion, distance = after, ahead
        elif self.how == "linear" and since:
            distance = max(since, ahead)
        if motion is None or distance > self.within or instant < oldest:
            return _sample(rows, _NO_MOTION, _NO_MOTION, _UNMATCHED)
        velocity, pose = motion.velocity, motion.pose
        if self.how == "linear" and since and after is not None:
            fraction = since / (since + ahead)
            with np.errstate(invalid="ignore"):
                linear = _interpolate(velocity[0].tolist(), after.velocity[0].tolist(), fraction)
                pose_rows = _interpolate_pose(pose[0].tolist(), after.pose[0].tolist(), fraction)
            velocity, pose = np.array([linear]), np.array([pose_rows])
        return _sample(rows, velocity, pose, _MATCHED)


def _interpolate(first: list[Real], second: list[Real], fraction: Real) -> list[Real]:
    """Interpolate each component linearly."""
    return [a + fraction * (b - a) for a, b in zip(first, second, strict=True)]


def _interpolate_pose(first: list[Real], second: list[Real], fraction: Real) -> list[Real]:
    """Interpolate a pose: the position linearly, the rotation at constant rate."""
    x, y, z = _interpolate(first[:3], second[:3], fraction)
    u, v, w = interpolate_rotation(
        (first[3], first[4], first[5]), (second[3], second[4], second[5]), fraction
    )
    return [x, y, z, u, v, w]


def _sample(rows: Zeroed, velocity: Reals, pose: Reals, matched: Flags) -> Sample:
    return Sample(
        rows.time, rows.counts, rows.temperature, rows.valid, velocity, pose, matched, finger=rows.finger
    )

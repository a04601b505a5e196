"""Arm that follows velocity commands, without contact."""

from math import inf

import numpy as np

from operators.batch import Reals, s
from operators.rotation import compose


class FreeArm:
    """An arm that follows velocity commands, without contact.

    Args:
        pose: Initial pose, (6,) m and rotation vector.
        acceleration: Maximum acceleration (m/s2 and rad/s2 together, default unlimited).

    >>> arm = FreeArm(np.zeros(6))
    >>> arm.command(1 * s, np.array([0.1, 0, 0, 0, 0, 0.5]))
    >>> pose, velocity = arm.motion(3 * s)
    >>> pose.tolist()
    [0.2, 0.0, 0.0, 0.0, 0.0, 1.0]
    """

    def __init__(self, pose: Reals, acceleration: float = inf) -> None:
        self._pose, self._velocity, self._target = pose.astype(np.float64), np.zeros(6), np.zeros(6)
        self._acceleration, self.push = acceleration, np.full(6, np.nan)
        self._time: int | None = None  # ns
        self._pending: list[tuple[int, Reals]] = []

    @property
    def wrench(self) -> Reals:
        """Force and torque on the tool (6,): `push`, by default not measured."""
        return self.push

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Return pose (6,) and velocity (6,) at an instant (ns); instants must not decrease."""
        while self._pending and self._pending[0][0] <= time:
            instant, target = self._pending.pop(0)
            self._move(instant)
            self._target = target
        self._move(time)
        return self._pose.copy(), self._velocity.copy()

    def command(self, time: int, velocity: Reals) -> None:
        """Apply a velocity (6,) from a time (ns) on."""
        self._pending.append((time, velocity.copy()))

    def _move(self, time: int) -> None:
        """Integrate the motion up to an instant (ns)."""
        if self._time is None or time <= self._time:
            self._time = time if self._time is None else self._time
            return
        span, change = (time - self._time) / s, self._target - self._velocity
        ramp = float(np.linalg.norm(change)) / self._acceleration  # s
        rising = min(span, ramp)
        velocity = self._velocity + change * (span / ramp if ramp > span else 1.0)
        travel = (self._velocity + velocity) / 2 * rising + velocity * (span - rising)  # (6,)
        self._pose[:3] += travel[:3]
        rotation = compose(tuple(self._pose[3:].tolist()), tuple(travel[3:].tolist()))
        self._pose[3:] = rotation
        self._time, self._velocity = time, velocity


class PressedArm(FreeArm):
    """A free arm whose TCP is pushed up below height 0, with 1000 N/m."""

    @property
    def wrench(self) -> Reals:
        """Force and torque on the tool (6,) at the latest motion."""
        return np.array([0.0, 0.0, 1000 * max(0.0, -self._pose.item(2)), 0.0, 0.0, 0.0])

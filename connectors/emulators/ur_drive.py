"""Motion of an emulated UR arm: movel, speedl and stopl as TCP velocities, per cycle.

With D the remaining distance (m, or the remaining angle in rad if that is larger), the speed of a line is

    speed = min(v, sqrt(a D), D / (4 cycles), previous speed + a * cycle)

so that it converges for every acceleration of the arm.
"""

from math import sqrt
from typing import Final, Literal, TypeAlias

import numpy as np

from operators.batch import Reals
from operators.rotation import rotation_difference

Task: TypeAlias = Literal["none", "line", "speed", "stop"]

POSE_TOLERANCE: Final = 5e-5  # m, rad; a UR10 has a repeatability of 1e-4 m
STANDSTILL: Final = 1e-3  # m/s, rad/s


class Drive:
    """Velocity generator of motion tasks; a new task replaces the current one without a step in velocity.

    Args:
        period: Duration of a cycle (s).
        acceleration: Maximum acceleration (m/s2 and rad/s2, default 1).

    Attributes:
        velocity: Commanded velocity (6,) m/s and rad/s, base frame.
        task: Current task; "none" when it is done.
    """

    def __init__(self, period: float, acceleration: float = 1.0) -> None:
        self._period, self._highest = period, acceleration
        self.velocity: Reals = np.zeros(6)
        self.task: Task = "none"
        self._target: Reals = np.zeros(6)  # pose of a line task, else velocity
        self._speed = self._acceleration = 0.0

    def line(self, pose: Reals, speed: float, acceleration: float) -> None:
        """Move straight to a pose (6,) m and rotation vector, at a speed (m/s) and acceleration (m/s2)."""
        self._begin("line", pose, speed, acceleration)

    def speed(self, velocity: Reals, acceleration: float) -> None:
        """Accelerate (m/s2 and rad/s2) to a velocity (6,) m/s and rad/s and keep it."""
        self._begin("speed", velocity, 0.0, acceleration)

    def stop(self, deceleration: float) -> None:
        """Decelerate to rest (m/s2 and rad/s2)."""
        self._begin("stop", np.zeros(6), 0.0, deceleration)

    def halt(self) -> None:
        """Abort the task and stop as fast as the arm can."""
        self._begin("stop", np.zeros(6), 0.0, self._highest)
        self.velocity = np.zeros(6)

    def step(self, pose: Reals, velocity: Reals) -> None:
        """Run one cycle with the measured pose (6,) and velocity (6,)."""
        if self.task == "line":
            self._follow(pose)
        elif self.task != "none":
            self._approach()
        resting = not self.velocity.any() and float(np.abs(velocity).max()) < STANDSTILL
        if self.task == "stop" and resting:
            self.task = "none"

    def _begin(self, task: Task, target: Reals, speed: float, acceleration: float) -> None:
        self.task, self._target, self._speed = task, target.copy(), speed
        self._acceleration = min(acceleration, self._highest)

    def _follow(self, pose: Reals) -> None:
        turn = rotation_difference(tuple(pose[3:].tolist()), tuple(self._target[3:].tolist()))
        remaining = np.concatenate((self._target[:3] - pose[:3], turn))  # (6,)
        distance = _extent(remaining)
        if distance < POSE_TOLERANCE:
            self.halt()
            return
        previous = max(0.0, float(self.velocity @ remaining) / float(remaining @ remaining)) * distance
        braking = sqrt(self._acceleration * distance)
        settling = distance / (4 * self._period)
        speed = min(self._speed, braking, settling, previous + self._acceleration * self._period)
        self.velocity = remaining * (speed / distance)

    def _approach(self) -> None:
        self.velocity = self.velocity.copy()
        for part in (slice(0, 3), slice(3, 6)):  # separate ramps for translation and rotation
            change = self._target[part] - self.velocity[part]
            fraction = self._acceleration * self._period / max(float(np.linalg.norm(change)), 1e-12)
            self.velocity[part] += change * min(1.0, fraction)


def _extent(change: Reals) -> float:
    """Return the larger of translation (m) and rotation (rad) of a change (6,)."""
    return float(max(np.linalg.norm(change[:3]), np.linalg.norm(change[3:])))

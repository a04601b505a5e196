"""How a UR controller drives its arm: movel, speedl and stopl as velocities of the TCP, cycle by cycle.

A line is driven by the distance that is left, D (m, or rad where the turn is the longer)::

    speed = min(v, sqrt(a D), D / (4 cycles), speed before + a * cycle)

so that any arm that follows, however it accelerates, ends where it should.
"""

from math import sqrt
from typing import Final, Literal, TypeAlias

import numpy as np

from operators.batch import Reals
from operators.rotation import onward

Task: TypeAlias = Literal["none", "line", "speed", "stop"]

NEAR: Final = 5e-5  # m, rad: the arm is there; a UR10 repeats to 1e-4 m
STILL: Final = 1e-3  # m/s, rad/s: the arm stands
HOPELESS: Final = 1.0  # s without progress after which an arm does not follow


class Drive:
    """Turns tasks into velocities; a new task replaces the old one at any time, without a jump.

    Args:
        period: Of the cycles, s.
        acceleration: The highest that the arm is driven with, m/s2 and rad/s2.

    Attributes:
        velocity: (6,) m/s and rad/s in the base frame: what is commanded now.
        task: What is being done; "none" when it is done.
        lost: The arm did not follow; the task was given up.
    """

    def __init__(self, period: float, acceleration: float = 1.0) -> None:
        self._period, self._highest = period, acceleration
        self.velocity: Reals = np.zeros(6)
        self.task: Task = "none"
        self.lost = False
        self._target: Reals = np.zeros(6)  # pose of a line, velocity of a speed
        self._speed = self._acceleration = 0.0
        self._best, self._idle = np.inf, 0.0  # how near it came to its end, and for how long (s) no nearer

    def line(self, pose: Reals, speed: float, acceleration: float) -> None:
        """Go straight to a pose (6,) m and rotation vector, at a speed (m/s) and acceleration (m/s2)."""
        self._begin("line", pose, speed, acceleration)

    def speed(self, velocity: Reals, acceleration: float) -> None:
        """Go on with a velocity (6,) m/s and rad/s, reached at an acceleration (m/s2 and rad/s2)."""
        self._begin("speed", velocity, 0.0, acceleration)

    def stop(self, deceleration: float) -> None:
        """Come to rest (m/s2 and rad/s2)."""
        self._begin("stop", np.zeros(6), 0.0, deceleration)

    def hold(self) -> None:
        """Stand still until the next step; the task goes on from there."""
        self.velocity = np.zeros(6)

    def halt(self) -> None:
        """Give the task up and stand still, as fast as the arm can."""
        self._begin("stop", np.zeros(6), 0.0, self._highest)
        self.velocity = np.zeros(6)

    def step(self, pose: Reals, velocity: Reals) -> None:
        """One cycle: where the arm really is, (6,), and how it moves, (6,)."""
        if self.task == "line":
            self._follow(pose)
        elif self.task != "none":
            self._approach()
        resting = not self.velocity.any() and float(np.abs(velocity).max()) < STILL
        if self.task == "stop" and resting:
            self.task = "none"
        if self.task in ("line", "stop") and self._idle > HOPELESS:
            self.lost, self.task, self.velocity = True, "none", np.zeros(6)

    def _begin(self, task: Task, target: Reals, speed: float, acceleration: float) -> None:
        self.task, self._target, self._speed = task, target.copy(), speed
        self._acceleration = min(acceleration, self._highest)
        self._best, self._idle, self.lost = np.inf, 0.0, False

    def _follow(self, pose: Reals) -> None:
        turn = onward(tuple(pose[3:].tolist()), tuple(self._target[3:].tolist()))
        left = np.concatenate((self._target[:3] - pose[:3], turn))  # (6,)
        distance = _extent(left)
        self._progress(distance, NEAR / 10)
        if distance < NEAR:
            self.halt()
            return
        before = max(0.0, float(self.velocity @ left) / float(left @ left)) * distance
        gentle = sqrt(self._acceleration * distance)
        soon = distance / (4 * self._period)
        speed = min(self._speed, gentle, soon, before + self._acceleration * self._period)
        self.velocity = left * (speed / distance)

    def _approach(self) -> None:
        self._progress(_extent(self._target - self.velocity), 0.0)
        self.velocity = self.velocity.copy()
        for part in (slice(0, 3), slice(3, 6)):  # they are ramped apart
            change = self._target[part] - self.velocity[part]
            share = self._acceleration * self._period / max(float(np.linalg.norm(change)), 1e-12)
            self.velocity[part] += change * min(1.0, share)

    def _progress(self, left: float, least: float) -> None:
        if left < self._best - least:
            self._best, self._idle = left, 0.0
        else:
            self._idle += self._period


def _extent(change: Reals) -> float:
    """The longer of a change's (6,) two parts, m and rad."""
    return float(max(np.linalg.norm(change[:3]), np.linalg.norm(change[3:])))

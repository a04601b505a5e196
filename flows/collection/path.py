"""The path of an arm as steps whose ends and durations are known before it moves. Pure.

Poses are those of the TCP in the base frame. The fingertip's frame is the TCP's: x right, y up, z into the
surface that it touches.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

from operators.rotation import onward, quaternion, turn, turned

Pose: TypeAlias = tuple[float, float, float, float, float, float]  # m, and rotation vector in rad
Place: TypeAlias = tuple[float, float, float]  # m


@dataclass(frozen=True, slots=True)
class Line:
    """Straight to a pose, and to rest there."""

    pose: Pose
    speed: float  # m/s; rad/s where the turn is the longer
    acceleration: float  # m/s2, rad/s2

    def end(self, start: Pose) -> Pose:
        """Where it ends."""
        del start
        return self.pose

    def seconds(self, start: Pose) -> float:
        """How long it takes.

        >>> Line((0.5, 0, 0, 0, 0, 0), speed=0.25, acceleration=0.5).seconds((0, 0, 0, 0, 0, 0))
        2.5
        """
        way = max(math.dist(start[:3], self.pose[:3]), math.hypot(*onward(start[3:], self.pose[3:])))
        if way * self.acceleration < self.speed**2:
            return 2 * math.sqrt(way / self.acceleration)
        return way / self.speed + self.speed / self.acceleration


@dataclass(frozen=True, slots=True)
class Slide:
    """Go on with a velocity for a time, then come to rest; begins at rest."""

    velocity: Pose  # m/s and rad/s
    time: float  # s, until it begins to come to rest
    acceleration: float  # m/s2, rad/s2

    def end(self, start: Pose) -> Pose:
        """Where it ends: what is lost while it speeds up is gained while it slows down."""
        x, y, z, a, b, c = (each * self._cruised for each in self.velocity)
        u, v, w = turned(start[3:], by=(a, b, c))
        return start[0] + x, start[1] + y, start[2] + z, u, v, w

    def seconds(self, start: Pose) -> float:
        """How long it takes."""
        del start
        return self.time + min(self.time, self._ramp)

    @property
    def _ramp(self) -> float:
        """Time that it takes to reach the velocity, s."""
        return max(math.hypot(*self.velocity[:3]), math.hypot(*self.velocity[3:])) / self.acceleration

    @property
    def _cruised(self) -> float:
        """Time at the velocity that takes as far, s."""
        return self.time if self._ramp <= self.time else self.time**2 / self._ramp


@dataclass(frozen=True, slots=True)
class Wait:
    """Stand still."""

    time: float  # s

    def end(self, start: Pose) -> Pose:
        """Where it began."""
        return start

    def seconds(self, start: Pose) -> float:
        """How long it takes."""
        del start
        return self.time


Step: TypeAlias = Line | Slide | Wait


@dataclass(frozen=True, slots=True)
class Extent:
    """How far a path reaches, and how long it takes."""

    seconds: float
    low: Place
    high: Place
    end: Pose

    @classmethod
    def of(cls, steps: Iterable[Step], start: Pose) -> "Extent":
        """That of steps from a pose: all are straight, so their ends tell."""
        seconds, places, pose = 0.0, [start[:3]], start
        for step in steps:
            seconds += step.seconds(pose)
            pose = step.end(pose)
            places.append(pose[:3])
        low, high = (tuple(map(each, zip(*places, strict=True))) for each in (min, max))
        return cls(seconds, (low[0], low[1], low[2]), (high[0], high[1], high[2]), pose)


def beside(pose: Pose, offset: Place = (0.0, 0.0, 0.0), yaw: float = 0.0) -> Pose:
    """A pose moved (m) in its own frame and turned (rad) about its own z.

    >>> [round(each, 6) for each in beside((0.4, 0, 0.1, math.pi, 0, 0), (0, 0.01, -0.02))[:3]]
    [0.4, -0.01, 0.12]
    """
    by = quaternion((pose[3], pose[4], pose[5]))
    x, y, z = turn(offset, by)
    a, b, c = turn((0.0, 0.0, yaw), by)
    u, v, w = turned((pose[3], pose[4], pose[5]), by=(a, b, c)) if yaw else pose[3:]
    return pose[0] + x, pose[1] + y, pose[2] + z, u, v, w


def heading(pose: Pose, linear: Place, spin: float = 0.0) -> Pose:
    """A velocity in a pose's own frame, m/s and about its z rad/s, in the base frame."""
    by = quaternion((pose[3], pose[4], pose[5]))
    return *turn(linear, by), *turn((0.0, 0.0, spin), by)


def raised(pose: Pose, place: Pose, clearance: float) -> Pose:
    """A pose, raised if it is less than `clearance` (m) above the plane through a place that looks into it.

    >>> up = raised((0.1, 0, -0.001, math.pi, 0, 0), (0, 0, 0, math.pi, 0, 0), 0.01)
    >>> [round(each, 6) for each in up[:3]]
    [0.1, 0.0, 0.01]
    """
    x, y, z = turn((0.0, 0.0, 1.0), quaternion((place[3], place[4], place[5])))
    deep = x * (pose[0] - place[0]) + y * (pose[1] - place[1]) + z * (pose[2] - place[2])
    lift = max(0.0, deep + clearance)
    return pose[0] - lift * x, pose[1] - lift * y, pose[2] - lift * z, *pose[3:]

"""Path of an arm: steps whose end poses and durations are known before it moves. No I/O.

Poses are those of the TCP in the base frame. The fingertip's frame is the TCP's: x right, y up, z into the
surface that it touches.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

from connectors.ur.ur_state import Point, Pose
from operators.rotation import compose, quaternion, rotate, rotation_difference


@dataclass(frozen=True, slots=True)
class Line:
    """Straight move to a pose."""

    pose: Pose
    speed: float  # m/s; rad/s if the rotation takes longer
    acceleration: float  # m/s2, rad/s2

    def end(self, start: Pose) -> Pose:
        """Return the pose at the end."""
        del start
        return self.pose

    def seconds(self, start: Pose) -> float:
        """Return the duration.

        >>> Line((0.5, 0, 0, 0, 0, 0), speed=0.25, acceleration=0.5).seconds((0, 0, 0, 0, 0, 0))
        2.5
        """
        rotation = math.hypot(*rotation_difference(start[3:], self.pose[3:]))  # rad
        distance = max(math.dist(start[:3], self.pose[:3]), rotation)
        if distance * self.acceleration < self.speed**2:
            return 2 * math.sqrt(distance / self.acceleration)
        return distance / self.speed + self.speed / self.acceleration


@dataclass(frozen=True, slots=True)
class Slide:
    """Move at a velocity for a time, from rest to rest."""

    velocity: Pose  # m/s and rad/s
    time: float  # s, until it starts to slow down
    acceleration: float  # m/s2, rad/s2

    def end(self, start: Pose) -> Pose:
        """Return the pose at the end: the distance lost while speeding up is gained while slowing down."""
        x, y, z, a, b, c = (each * self.cruise for each in self.velocity)
        u, v, w = compose(start[3:], by=(a, b, c))
        return start[0] + x, start[1] + y, start[2] + z, u, v, w

    def seconds(self, start: Pose) -> float:
        """Return the duration."""
        del start
        return self.time + min(self.time, self._ramp)

    @property
    def _ramp(self) -> float:
        """Time to reach the velocity, s."""
        return max(math.hypot(*self.velocity[:3]), math.hypot(*self.velocity[3:])) / self.acceleration

    @property
    def cruise(self) -> float:
        """Time at constant velocity that covers the same distance, s."""
        return self.time if self._ramp <= self.time else self.time**2 / self._ramp


@dataclass(frozen=True, slots=True)
class Wait:
    """Standstill."""

    time: float  # s

    def end(self, start: Pose) -> Pose:
        """Return the pose at the end."""
        return start

    def seconds(self, start: Pose) -> float:
        """Return the duration."""
        del start
        return self.time


@dataclass(frozen=True, slots=True)
class Trace:
    """Move along a line of points at constant speed and orientation."""

    points: tuple[Point, ...]  # m
    speed: float  # m/s
    acceleration: float  # m/s2

    def end(self, start: Pose) -> Pose:
        """Return the pose at the end."""
        return *self.points[-1], *start[3:]

    def seconds(self, start: Pose) -> float:
        """Return the duration."""
        distance = sum(math.dist(a, b) for a, b in pairwise((start[:3], *self.points)))
        return distance / self.speed + self.speed / self.acceleration


Step: TypeAlias = Line | Slide | Wait | Trace


@dataclass(frozen=True, slots=True)
class Extent:
    """Bounding box, duration and end of a path."""

    seconds: float
    low: Point
    high: Point
    end: Pose

    @classmethod
    def of(cls, steps: Iterable[Step], start: Pose) -> "Extent":
        """Return the extent of steps from a pose; all but traces are straight, so their ends suffice."""
        seconds, points, pose = 0.0, [start[:3]], start
        for step in steps:
            seconds += step.seconds(pose)
            pose = step.end(pose)
            points += step.points if isinstance(step, Trace) else [pose[:3]]
        low, high = (tuple(map(each, zip(*points, strict=True))) for each in (min, max))
        return cls(seconds, (low[0], low[1], low[2]), (high[0], high[1], high[2]), pose)


def spin_velocity(pose: Pose, spin: float) -> Pose:
    """Return the velocity in the base frame of a rotation about a pose's own z (rad/s)."""
    return 0.0, 0.0, 0.0, *rotate((0.0, 0.0, spin), quaternion((pose[3], pose[4], pose[5])))

"""Path of an arm: steps whose end poses and durations are known before it moves. No I/O.

Poses are those of the TCP in the base frame. The fingertip's frame is the TCP's: x right, y up, z into the
surface that it touches.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

from connectors.ur.ur_state import Point, Pose, offset_pose
from operators.rotation import rotation_difference


@dataclass(frozen=True, slots=True)
class Line:
    """Move along straight lines through poses to the last one; through several, without rotation."""

    poses: tuple[Pose, ...]
    speed: float  # m/s; rad/s if the rotation takes longer
    acceleration: float  # m/s2, rad/s2

    def end(self, start: Pose) -> Pose:
        """Return the pose at the end."""
        del start
        return self.poses[-1]

    def seconds(self, start: Pose) -> float:
        """Return the duration.

        >>> Line(((0.5, 0, 0, 0, 0, 0),), speed=0.25, acceleration=0.5).seconds((0, 0, 0, 0, 0, 0))
        2.5
        """
        distance = sum(
            max(math.dist(a[:3], b[:3]), math.hypot(*rotation_difference(a[3:], b[3:])))  # m or rad
            for a, b in pairwise((start, *self.poses))
        )
        if distance * self.acceleration < self.speed**2:
            return 2 * math.sqrt(distance / self.acceleration)
        return distance / self.speed + self.speed / self.acceleration


@dataclass(frozen=True, slots=True)
class Turn:
    """Rotate about the fingertip's own z at a speed for a time, from rest to rest."""

    spin: float  # rad/s, anticlockwise
    time: float  # s, until it starts to slow down
    acceleration: float  # rad/s2

    @property
    def _ramp(self) -> float:
        """Time to reach the speed, s."""
        return abs(self.spin) / self.acceleration

    @property
    def angle(self) -> float:
        """Angle, rad: what is lost while speeding up is gained while slowing down."""
        return self.spin * self.time * min(1.0, self.time / self._ramp)

    def end(self, start: Pose) -> Pose:
        """Return the pose at the end."""
        return offset_pose(start, yaw=self.angle)

    def seconds(self, start: Pose) -> float:
        """Return the duration."""
        del start
        return self.time + min(self.time, self._ramp)


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


Step: TypeAlias = Line | Turn | Wait


@dataclass(frozen=True, slots=True)
class Extent:
    """Bounding box and duration of a path."""

    seconds: float
    low: Point
    high: Point

    @classmethod
    def of(cls, steps: Iterable[Step], start: Pose) -> "Extent":
        """Return the extent of steps from a pose."""
        seconds, points, pose = 0.0, [start[:3]], start
        for step in steps:
            seconds += step.seconds(pose)
            pose = step.end(pose)
            points += [each[:3] for each in (step.poses if isinstance(step, Line) else (pose,))]
        low, high = (tuple(map(each, zip(*points, strict=True))) for each in (min, max))
        return cls(seconds, (low[0], low[1], low[2]), (high[0], high[1], high[2]))

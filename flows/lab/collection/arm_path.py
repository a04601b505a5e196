"""The path of an arm as steps whose ends and durations are known, or bounded, before it moves. Pure.

Poses are those of the TCP in the base frame. The fingertip's frame is the TCP's: x right, y up, z into the
surface that it touches.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
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
class _Standstill:
    """A time in which the arm stays where it is."""

    time: float  # s

    def end(self, start: Pose) -> Pose:
        """Where it began."""
        return start

    def seconds(self, start: Pose) -> float:
        """How long it takes."""
        del start
        return self.time


@dataclass(frozen=True, slots=True)
class Wait(_Standstill):
    """Stand still."""


@dataclass(frozen=True, slots=True)
class Trace:
    """Along a line of places at one speed, turned as it began, and to rest at the last."""

    places: tuple[Place, ...]  # m
    speed: float  # m/s
    acceleration: float  # m/s2

    def end(self, start: Pose) -> Pose:
        """Where it ends."""
        return *self.places[-1], *start[3:]

    def seconds(self, start: Pose) -> float:
        """How long it takes."""
        way = sum(math.dist(a, b) for a, b in pairwise((start[:3], *self.places)))
        return way / self.speed + self.speed / self.acceleration


@dataclass(frozen=True, slots=True)
class Tare(_Standstill):
    """Stand still in the air, and take the force that is told there for none."""


@dataclass(frozen=True, slots=True)
class Touchdown:
    """Straight on until what is touched pushes back with a force; it has to, before the way ends."""

    way: Place  # m, the longest
    force: float  # N, along the way
    speed: float  # m/s
    acceleration: float  # m/s2

    def end(self, start: Pose) -> Pose:
        """Where it ends at the latest."""
        return start[0] + self.way[0], start[1] + self.way[1], start[2] + self.way[2], *start[3:]

    def seconds(self, start: Pose) -> float:
        """How long it takes at most."""
        del start
        return math.hypot(*self.way) / self.speed + self.speed / self.acceleration

    def spared(self, start: Pose, here: Pose) -> Place:
        """How far (m) it ended before its latest end, where it began at a start and is here now.

        >>> Touchdown((0, 0, -0.005), 2.0, 0.002, 0.5).spared((0, 0, 0.001, 0, 0, 0), (0, 0, -0.002, 0, 0, 0))
        (0.0, 0.0, 0.002)
        """
        latest, longest = self.end(start), math.hypot(*self.way)
        left = sum(d * (end - at) for d, end, at in zip(self.way, latest, here, strict=False)) / longest**2
        x, y, z = (0.0 - left * each for each in self.way)
        return x, y, z


Step: TypeAlias = Line | Slide | Wait | Trace | Tare | Touchdown


@dataclass(frozen=True, slots=True)
class Extent:
    """How far a path reaches, and how long it takes."""

    seconds: float
    low: Place
    high: Place
    end: Pose

    @classmethod
    def of(cls, steps: Iterable[Step], start: Pose) -> "Extent":
        """That of steps from a pose at their latest ends, which tell, but of a trace: all are straight."""
        seconds, places, pose = 0.0, [start[:3]], start
        for step in steps:
            seconds += step.seconds(pose)
            pose = step.end(pose)
            places += step.places if isinstance(step, Trace) else [pose[:3]]
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


def shifted(steps: Sequence[Step], by: Place) -> list[Step]:
    """Steps that lead to other places, by so much (m)."""
    moved = list[Step]()
    for step in steps:
        match step:
            case Line(pose):
                moved.append(replace(step, pose=(*_sum(pose[:3], by), *pose[3:])))
            case Trace(places):
                moved.append(replace(step, places=tuple(_sum(place, by) for place in places)))
            case _:
                moved.append(step)
    return moved


def _sum(place: Place, by: Place) -> Place:
    return place[0] + by[0], place[1] + by[1], place[2] + by[2]


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

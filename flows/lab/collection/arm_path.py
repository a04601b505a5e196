"""Surfaces and the path of an arm over them, in steps that are known before it moves. No I/O.

Poses are those of the TCP in the base frame. The fingertip's frame is the TCP's: x right, y up, z into the
surface that it touches.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias, get_args

from connectors.sim.scene import Scene, surface_drop
from connectors.ur.ur_state import Point, Pose, offset_pose
from flows.graph.quantity import Length
from operators.batch import Curvature
from operators.checks import check_between, check_choice
from operators.errors import ParameterError
from operators.rotation import rotation_difference

RADIUS: Final = Scene().radius  # m, of curved surfaces, as in the simulated rig
MIN_RADIUS: Final = 0.001  # m
MAX_RADIUS: Final = 1.0  # m; a flatter surface is a plane
MAX_POSE: Final = 10.0  # m and rad, of each coordinate; no arm exceeds it
STEEPEST: Final = math.radians(45)  # slope at the end of a stroke
_FLAT: Final = 1e-6  # rad, slope below which a path is straight
_SPACING: Final = 0.002  # m, between the points along an arc


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface; a table [[surfaces]] of a plan file.

    In its pose the fingertip just touches the middle of the surface, its highest point.

    Raises:
        ParameterError: on an unknown shape, or a radius or pose out of range.
    """

    shape: Curvature = "plane"  # cylinder_x and cylinder_y: axis along the fingertip's x or y
    radius: Length = RADIUS  # of a curved surface
    pose: Pose | None = None  # of the TCP; None: the arm's pose at the start

    def __post_init__(self) -> None:
        check_choice("Surface", "shape", self.shape, get_args(Curvature))
        check_between("Surface", "radius", self.radius, MIN_RADIUS, MAX_RADIUS, unit="m")
        for each in self.pose or ():
            check_between("Surface", "pose", each, -MAX_POSE, MAX_POSE)

    @property
    def middle(self) -> Pose:
        """Pose of a surface that has one."""
        assert self.pose, "a series gives it to the surface"
        return self.pose

    @property
    def curvatures(self) -> tuple[float, float]:
        """Curvatures along the fingertip's x and y, 1/m."""
        return Scene(curvature=self.shape, radius=self.radius).curvatures

    def at(self, x: float, y: float, depth: float = 0.0) -> Pose:
        """Return the pose of the fingertip pressed by a depth (m) at an offset (m) from the middle.

        >>> round(Surface("sphere", 0.05, (0.4, 0, 0.1, math.pi, 0, 0)).at(0.03, 0.0)[2], 6)
        0.09
        """
        return offset_pose(self.middle, (x, y, surface_drop(self.curvatures, x, y) + depth))

    def waypoints(self, x: float, y: float) -> list[float]:
        """Return the waypoints from (-x, -y) to (x, y) (m) over the surface, as multiples of (x, y).

        The last one is 1, the end; on a straight path it is the only one.

        Raises:
            ParameterError: if the surface is too steep at the end.

        >>> Surface("plane").waypoints(0.03, 0.0)
        [1.0]
        """
        kx, ky = self.curvatures
        slope, half = math.hypot(kx * x, ky * y), math.hypot(x, y)  # the sine of its angle; m
        if slope > math.sin(STEEPEST):
            least = slope * self.radius / math.sin(STEEPEST)
            must_be = f"at least {least:.4f} m for strokes of {half:.4f} m to each side of the middle"
            raise ParameterError("Surface", "radius", self.radius, must_be)
        if slope < _FLAT:
            return [1.0]
        steps = math.ceil(2 * half / _SPACING)
        return [2 * number / steps - 1 for number in range(1, steps + 1)]


@dataclass(frozen=True, slots=True)
class Line:
    """Move along straight lines through poses to the last one; through several, without rotation."""

    poses: tuple[Pose, ...]
    speed: float  # m/s; rad/s if the rotation takes longer
    acceleration: float  # m/s2, rad/s2

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

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return self.time + min(self.time, self._ramp)


Step: TypeAlias = Line | Turn | float  # a number: standstill, s


def extent(steps: Iterable[Step], start: Pose) -> tuple[float, Point, Point]:
    """Return the duration (s) of steps from a pose, and the corners of their bounding box (m)."""
    seconds, points, pose = 0.0, [start[:3]], start
    for step in steps:
        match step:
            case Line(poses):
                seconds += step.seconds(pose)
                points += [each[:3] for each in poses]
                pose = poses[-1]
            case Turn():
                seconds += step.seconds
                pose = offset_pose(pose, yaw=step.angle)
            case standstill:
                seconds += standstill
    low, high = (tuple(map(each, zip(*points, strict=True))) for each in (min, max))
    return seconds, (low[0], low[1], low[2]), (high[0], high[1], high[2])

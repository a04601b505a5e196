"""Collection plan for a real arm: strokes to record on each surface, and the path that makes them. No I/O.

As in "Under Pressure" (2021), one fingertip slides over a surface at 0.05, 0.075 and 0.1 m/s in eight
directions, and rotates at 1 rad/s. Each stroke moves down onto the surface, rests, slides through its middle,
rests, and moves up again; between strokes the fingertip moves through the air.

A stroke is pressed to a depth after first contact. Over a curved surface it follows the arc at constant
orientation, so a slope requires a compliant finger.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Annotated, Final, TypeAlias

import numpy as np

from connectors.ur.control_process import WATCHDOG
from connectors.ur.ur_state import Bounds, Point, Pose, offset_pose
from flows.graph.quantity import Duration, Force, Length, Speed
from flows.lab.collection.arm_path import MAX_POSE, Line, Step, Surface, Turn, extent
from flows.learn.labelled_recordings import PAPER_LABEL, TURNS
from operators.batch import s
from operators.checks import check_at_least, check_between
from operators.errors import ParameterError
from operators.ports import Json

Seconds: TypeAlias = Annotated[float, "s"]

MAX_SPEED: Final = 0.3  # m/s; above it `Label` gives no label
MOST: Final = 100  # sessions of one kind on a surface, rounds in a session
_DIRECTIONS: Final = 8
_SLIPPING: Final = 0.25  # rad/s, above the slowest slip of `PAPER_LABEL`
_RANGES: Final = {  # lowest and highest value of each setting and limit, and its unit
    "depth": (0, 0.006, "m"),  # a fingertip yields by a few mm
    "slide_time": (0.01, 60, "s"),
    "rotation_time": (0.01, 60, "s"),
    "rotation_speed": (_SLIPPING, 3, "rad/s"),
    "rotation_acceleration": (0.01, 5, "rad/s2"),
    "rest": (0, 60, "s"),
    "baseline": (1, 600, "s"),  # `Zero` measures in the first second
    "clearance": (0.003, 0.5, "m"),  # up to 2 mm above the surface counts as contact (`MaskLifted`)
    "travel_speed": (0.002, 1, "m/s"),  # a slower arm counts as arrived up to 0.5 mm early
    "press_speed": (0.002, MAX_SPEED, "m/s"),
    "acceleration": (0.01, 5, "m/s2"),
    "force": (1, 250, "N"),
    "margin": (0.0001, 0.1, "m"),
    "sensor_timeout": (0.05, 5, "s"),  # a fingertip is sampled every 10 ms
    "watchdog": (0.1, 10, "Hz"),  # the arm gets a command every 50 ms
}


@dataclass(frozen=True, slots=True)
class PathSettings:
    """Depth, times, speeds and heights of the path; the keys of [path] in a plan file.

    Raises:
        ParameterError: if a value is out of range.
    """

    depth: Length = 0.0015  # of a press after first contact
    slide_time: Seconds = 0.6
    rotation_time: Seconds = 1.2
    rotation_speed: float = 1.0  # rad/s; paper
    rotation_acceleration: float = 1.0  # rad/s2
    rest: Seconds = 0.4
    baseline: Seconds = 1.5
    clearance: Length = 0.01
    travel_speed: Speed = 0.1
    press_speed: Speed = 0.02
    acceleration: float = 0.5  # m/s2

    def __post_init__(self) -> None:
        _check_ranges(self, self.__slots__)
        acceleration, turn = self.rotation_acceleration, 6.28 / self.rotation_speed  # rad/s2, s
        check_at_least("PathSettings", "rotation_acceleration", acceleration, _SLIPPING / turn, "rad/s2")
        slipping = _SLIPPING / acceleration  # s, from the start of a rotation
        check_between("PathSettings", "rotation_time", self.rotation_time, slipping, turn, unit="s")


@dataclass(frozen=True, slots=True)
class Limits:
    """Safety limits, at which the arm is stopped; the keys of [limits] in a plan file.

    Raises:
        ParameterError: if a value is out of range.
    """

    force: Force = 50.0
    workspace: tuple[float, float, float, float, float, float] | None = None  # m
    margin: Length = 0.005
    sensor_timeout: Seconds = 0.3
    watchdog: float = WATCHDOG  # Hz
    require_contact: bool = True

    def __post_init__(self) -> None:
        _check_ranges(self, ("force", "margin", "sensor_timeout", "watchdog"))
        for edge in self.workspace or ():
            check_between("Limits", "workspace", edge, -MAX_POSE, MAX_POSE, unit="m")


def _check_ranges(settings: PathSettings | Limits, names: Iterable[str]) -> None:
    for name in names:
        low, high, unit = _RANGES[name]
        check_between(type(settings).__name__, name, getattr(settings, name), low, high, unit=unit)


@dataclass(frozen=True, slots=True)
class Stroke:
    """One contact with the surface."""

    direction: float  # rad, in the fingertip's plane, anticlockwise from x
    speed: float  # m/s; rad/s of a rotation, anticlockwise
    approach: tuple[Line, ...]  # through the air, and down
    contact: tuple[Step, ...]
    retreat: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class StrokeSeries:
    """Strokes over one surface at one speed, which are recorded as one session of the dataset."""

    name: str
    surface: Surface
    speed: float | None  # m/s; None: rotations
    begin: Line  # to the start, in the air
    strokes: tuple[Stroke, ...]
    split: str
    plan: "CollectionPlan"

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps of the whole path, from any pose; it ends in the air."""
        parts = chain.from_iterable((each.approach, each.contact, each.retreat) for each in self.strokes)
        return self.begin, self.plan.path.baseline, *chain.from_iterable(parts)

    def describe(self) -> dict[str, Json]:
        """Return surface, speed, press and number of strokes as JSON data."""
        surface = self.surface
        return {
            "surface": surface.shape,
            "radius": None if surface.shape == "plane" else surface.radius,
            "place": list(surface.middle),
            "speed": self.speed,
            "depth": self.plan.path.depth,
            "strokes": len(self.strokes),
            "split": self.split,
        }


@dataclass(frozen=True, slots=True)
class CollectionPlan:
    """Strokes to collect on each surface; the keys of a plan file. The defaults are the paper's.

    Raises:
        ParameterError: on an invalid value.

    >>> plan = CollectionPlan(speeds=(0.05,), repeats=1, rotations=1, rounds=1)
    >>> [(series.name, len(series.strokes)) for series in plan.series((0.4, 0, 0.1, math.pi, 0, 0))]
    [('plane-050-01', 8), ('plane-rotation-01', 8)]
    """

    name: str = "paper"
    speeds: tuple[Speed, ...] = (0.05, 0.075, 0.1)
    repeats: int = 9
    rotations: int = 5
    rounds: int = 2
    seed: int = 0
    label_delay: Duration = 0
    surfaces: tuple[Surface, ...] = (Surface(),)
    path: PathSettings = PathSettings()
    limits: Limits = Limits()

    def __post_init__(self) -> None:
        if not all(PAPER_LABEL.speed < speed < MAX_SPEED for speed in self.speeds):
            must_be = f"above {PAPER_LABEL.speed} m/s (slower is labelled static) and below {MAX_SPEED} m/s"
            raise ParameterError(self.name, "speeds", self.speeds, must_be)
        check_between(self.name, "label_delay", self.label_delay, 0, s, unit="ns")
        check_at_least(self.name, "seed", self.seed, 0)
        for name, least in (("repeats", 0), ("rotations", 0), ("rounds", 1)):
            check_between(self.name, name, getattr(self, name), least, MOST)
        if not self.rotations and not (self.repeats and self.speeds):
            raise ParameterError(self.name, "repeats", self.repeats, "1 or more, or give rotations")
        poses = [each.pose for each in self.surfaces]
        if not poses or len(set(poses)) < len(poses):
            must_be = "one or more tables [[surfaces]], each with a different pose"
            raise ParameterError(self.name, "surfaces", len(poses), must_be)

    def series(self, here: Pose) -> list[StrokeSeries]:
        """Return all series, surface by surface; directions are in random order.

        Each surface, speed and split appears in the same proportion (`TURNS`).

        Args:
            here: Pose of a surface without one in the plan.

        Raises:
            ParameterError: if a surface is too steep at the end of a stroke.
        """
        random = np.random.default_rng(self.seed)
        speeds = [speed for speed in self.speeds for _ in range(self.repeats)] + [None] * self.rotations
        counted, series, first = dict[str, int](), list[StrokeSeries](), int(random.integers(len(TURNS)))
        for surface in (replace(each, pose=each.pose or here) for each in self.surfaces):
            for speed in speeds:
                group = f"{surface.shape}-{'rotation' if speed is None else f'{1000 * speed:03.0f}'}"
                counted[group] = counted.get(group, 0) + 1
                series.append(
                    StrokeSeries(
                        f"{group}-{counted[group]:02d}",
                        surface,
                        speed,
                        self._through_air(surface, 0.0, 0.0),
                        tuple(self._strokes(surface, speed, random)),
                        TURNS[(first + len(series)) % len(TURNS)],
                        self,
                    )
                )
        return series

    def _strokes(
        self, surface: Surface, speed: float | None, random: np.random.Generator
    ) -> Iterator[Stroke]:
        path = self.path
        for _ in range(self.rounds):
            for number, direction in enumerate(random.permutation(_DIRECTIONS).tolist()):
                if speed is None:
                    spin = path.rotation_speed if number % 2 else -path.rotation_speed
                    turn = Turn(spin, path.rotation_time, path.rotation_acceleration)
                    begin = replace(surface, pose=offset_pose(surface.middle, yaw=-turn.angle / 2))
                    end = replace(surface, pose=offset_pose(begin.middle, yaw=turn.angle))
                    yield self._stroke(0.0, spin, turn, (begin, 0.0, 0.0), (end, 0.0, 0.0))
                else:
                    heading, half = math.radians(45.0 * direction), speed * path.slide_time / 2
                    x, y = half * math.cos(heading), half * math.sin(heading)
                    points = surface.waypoints(x, y)
                    poses = tuple(surface.at(part * x, part * y, path.depth) for part in points)
                    slide = Line(poses, speed, path.acceleration)
                    yield self._stroke(heading, speed, slide, (surface, -x, -y), (surface, x, y))

    def _stroke(
        self,
        direction: float,
        speed: float,
        move: Line | Turn,
        begin: tuple[Surface, float, float],
        end: tuple[Surface, float, float],
    ) -> Stroke:
        """Return a stroke between offsets (m) from the middle of a surface."""
        path, (surface, x, y) = self.path, begin
        down = Line((surface.at(x, y, path.depth),), path.press_speed, path.acceleration)
        return Stroke(
            direction,
            speed,
            approach=(self._through_air(*begin), down),
            contact=(path.rest, move, path.rest),
            retreat=(replace(self._through_air(*end), speed=path.press_speed),),
        )

    def _through_air(self, surface: Surface, x: float, y: float) -> Line:
        """Return the move to above an offset (m) from the middle; all are at one height, above the middle."""
        path = self.path
        pose = offset_pose(surface.middle, (x, y, -path.clearance))
        return Line((pose,), path.travel_speed, path.acceleration)


@dataclass(frozen=True, slots=True)
class PlannedPath:
    """Path of a plan from the arm's pose, and the bounds within which the arm may move."""

    plan: CollectionPlan
    series: tuple[StrokeSeries, ...]
    seconds: float
    low: Point  # m, of the bounding box of the path
    high: Point  # m
    bounds: Bounds  # workspace as planned, or the path with its margin

    @classmethod
    def of(cls, plan: CollectionPlan, surface: Pose, here: Pose) -> "PlannedPath":
        """Return the path of a plan.

        Args:
            plan: The plan.
            surface: Pose of a surface without one in the plan.
            here: Pose of the arm.

        Raises:
            ParameterError: if a surface is too steep, or the path leaves the planned workspace.
        """
        series, limits = tuple(plan.series(surface)), plan.limits
        seconds, low, high = extent(chain.from_iterable(each.steps for each in series), here)
        if limits.workspace is None:
            a, b, c = (each - limits.margin for each in low)
            d, e, f = (each + limits.margin for each in high)
            return cls(plan, series, seconds, low, high, Bounds((a, b, c), (d, e, f), limits.force))
        lowest, highest = limits.workspace[:3], limits.workspace[3:]
        for axis, a, b, c, d in zip("xyz", lowest, low, high, highest, strict=True):
            if not a <= b <= c <= d:
                must_be = f"around the path, which leads from {b:.4f} to {c:.4f} m along {axis}"
                raise ParameterError("collect", "limits.workspace", limits.workspace, must_be)
        return cls(plan, series, seconds, low, high, Bounds(lowest, highest, limits.force))

"""Collection plans for a real arm: what to record on which surface, and the path that does it. Pure.

As in "Under Pressure" (2021): one fingertip over a surface at 0.05, 0.075 and 0.1 m/s in eight directions,
and turned at 1 rad/s. Each stroke comes down onto the surface, rests, slides through the middle of the place,
rests, and goes up again; the way to the next leads through the air.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from types import MappingProxyType
from typing import Final, get_args

import numpy as np

from connectors.rig.scene import Curvature
from flows.collection.path import Extent, Line, Pose, Slide, Step, Wait, beside, heading
from operators.errors import ParameterError

_TURNS: Final = ("train", "train", "test", "train", "validation", "train", "train", "test", "train", "train")
_DIRECTIONS: Final = 8


@dataclass(frozen=True, slots=True)
class Surface:
    """What is slid over.

    Raises:
        ParameterError: on a curvature that there is not.
    """

    curvature: Curvature
    place: Pose  # where the fingertip just touches it, in the middle

    def __post_init__(self) -> None:
        if self.curvature not in get_args(Curvature):
            known = ", ".join(get_args(Curvature))
            raise ParameterError("Surface", "curvature", self.curvature, f"one of {known}")


@dataclass(frozen=True, slots=True)
class Stroke:
    """One touch of the surface."""

    direction_deg: float  # in the fingertip's plane, anticlockwise from x
    speed: float  # m/s; rad/s of a rotation, anticlockwise
    spins: bool
    approach: tuple[Step, ...]  # through the air, and down
    contact: tuple[Step, ...]
    retreat: tuple[Step, ...]

    @property
    def motion(self) -> str:
        """What a dataset calls it."""
        return "rotation" if self.spins else "translation"

    @property
    def axis(self) -> str:
        """Whether it goes along an axis of the fingertip or across both."""
        return "oblique" if self.direction_deg % 90 else "primary"

    @property
    def steps(self) -> tuple[Step, ...]:
        """All of it."""
        return *self.approach, *self.contact, *self.retreat


@dataclass(frozen=True, slots=True)
class Session:
    """What becomes one session of the dataset: strokes over one surface at one speed."""

    name: str
    surface: Surface
    speed: float | None  # m/s; None: rotations
    begin: Line  # to where it begins, in the air
    clearance: float  # m above the surface, in the air
    air: Wait  # for the baseline
    strokes: tuple[Stroke, ...]
    split: str

    @property
    def steps(self) -> tuple[Step, ...]:
        """Its path from anywhere; it ends in the air."""
        return self.begin, self.air, *chain.from_iterable(stroke.steps for stroke in self.strokes)


@dataclass(frozen=True, slots=True)
class Plan:
    """What to collect on each surface, and how.

    Raises:
        ParameterError: on a value that cannot be.

    >>> plan = PLANS["tiny"]
    >>> sessions = plan.sessions([Surface("plane", (0.4, 0, 0.1, math.pi, 0, 0))], seed=0)
    >>> [(session.name, len(session.strokes)) for session in sessions]
    [('plane-050-01', 8), ('plane-rotation-01', 8)]
    """

    speeds: tuple[float, ...] = (0.05, 0.075, 0.1)  # m/s; paper
    repeats: int = 9  # sessions of each speed
    rotations: int = 5  # sessions of turns at 1 rad/s
    rounds: int = 2  # of eight strokes in a session
    depth: float = 0.0015  # m, by which the fingertip is pressed beyond its first touch
    time: float = 0.6  # s at its speed that take as far as a slide
    turn: float = 1.2  # s, of a rotation
    rest: float = 0.4  # s, in contact before and after a slide
    air: float = 1.5  # s, that a session begins with; the baseline takes one
    clearance: float = 0.01  # m above the surface, in the air
    travel: float = 0.1  # m/s through the air
    press: float = 0.02  # m/s down and up
    acceleration: float = 0.5  # m/s2
    spin: float = 1.0  # rad/s; paper
    spin_acceleration: float = 1.0  # rad/s2

    def __post_init__(self) -> None:
        for name in ("time", "turn", "air", "clearance", "travel", "press", "acceleration", "spin"):
            if not getattr(self, name) > 0:
                raise ParameterError("Plan", name, getattr(self, name), "above 0")
        for name in ("repeats", "rotations", "rounds", "depth", "rest"):
            if not getattr(self, name) >= 0:
                raise ParameterError("Plan", name, getattr(self, name), "0 or above")
        if not all(0 < speed < 0.3 for speed in self.speeds):  # noqa: PLR2004 - the label's limit
            raise ParameterError("Plan", "speeds", self.speeds, "above 0 and below 0.3 m/s")

    def sessions(self, surfaces: Sequence[Surface], seed: int) -> list[Session]:
        """All sessions, surface by surface; the order of directions, and the splits, are drawn.

        Like sessions (of a surface and a speed) are split by turns, so that each split has its share.

        Raises:
            ParameterError: if there is nothing to do.
        """
        random = np.random.default_rng(seed)
        speeds = [speed for speed in self.speeds for _ in range(self.repeats)] + [None] * self.rotations
        if not (surfaces and speeds and self.rounds):
            raise ParameterError("Plan", "sessions", 0, "1 or more")
        counted, sessions, first = dict[str, int](), list[Session](), int(random.integers(len(_TURNS)))
        for surface in surfaces:
            for speed in speeds:
                kind = "rotation" if speed is None else f"{1000 * speed:03.0f}"
                group = f"{surface.curvature}-{kind}"
                counted[group] = counted.get(group, 0) + 1
                strokes = tuple(self._strokes(surface.place, speed, random))
                sessions.append(
                    Session(
                        f"{group}-{counted[group]:02d}",
                        surface,
                        speed,
                        self._through_air(surface.place),
                        self.clearance,
                        Wait(self.air),
                        strokes,
                        _TURNS[(first + len(sessions)) % len(_TURNS)],
                    )
                )
        return sessions

    def _strokes(self, place: Pose, speed: float | None, random: np.random.Generator) -> Iterator[Stroke]:
        for _ in range(self.rounds):
            for number, direction in enumerate(random.permutation(_DIRECTIONS).tolist()):
                if speed is None:
                    spin = self.spin if number % 2 else -self.spin
                    yield self._stroke(place, 0.0, spin, spins=True)
                else:
                    yield self._stroke(place, 45.0 * direction, speed, spins=False)

    def _stroke(self, place: Pose, direction_deg: float, speed: float, *, spins: bool) -> Stroke:
        slide: Step
        if spins:
            slide = Slide(heading(place, (0.0, 0.0, 0.0), speed), self.turn, self.spin_acceleration)
            ramp = abs(speed) / self.spin_acceleration
            angle = speed * (self.turn if ramp <= self.turn else self.turn**2 / ramp)
            begin = beside(place, yaw=-angle / 2)
        else:  # by its end: the controller keeps to it, however late we are
            along, half = math.radians(direction_deg), speed * self.time / 2
            offset = half * math.cos(along), half * math.sin(along)
            begin = beside(place, (-offset[0], -offset[1], 0.0))
            slide = Line(beside(place, (*offset, self.depth)), speed, self.acceleration)
        down = beside(begin, (0.0, 0.0, self.depth))
        up = beside(slide.end(down), (0.0, 0.0, -self.depth - self.clearance))
        return Stroke(
            direction_deg,
            speed,
            spins,
            approach=(
                self._through_air(begin),
                Line(down, self.press, self.acceleration),
            ),
            contact=(Wait(self.rest), slide, Wait(self.rest)),
            retreat=(Line(up, self.press, self.acceleration),),
        )

    def _through_air(self, place: Pose) -> Line:
        """The way to above a place."""
        return Line(beside(place, (0.0, 0.0, -self.clearance)), self.travel, self.acceleration)


PLANS: Final[Mapping[str, Plan]] = MappingProxyType(
    {"paper": Plan(), "tiny": Plan(speeds=(0.05,), repeats=1, rotations=1, rounds=1, rest=0.3)}
)


def named(name: str) -> Plan:
    """A built-in plan.

    Raises:
        ParameterError: if there is none of that name.
    """
    if name not in PLANS:
        raise ParameterError("collect", "plan", name, f"one of {', '.join(PLANS)}")
    return PLANS[name]


def extent(sessions: Sequence[Session], start: Pose | None = None) -> Extent:
    """How far all sessions reach and how long they take, from a pose or from above the first surface."""
    begin = sessions[0].begin.pose if start is None else start
    return Extent.of(chain.from_iterable(session.steps for session in sessions), begin)

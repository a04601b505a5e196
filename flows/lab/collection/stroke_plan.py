"""Collection plans for a real arm: what to record on which surface, and the path that does it. Pure.

As in "Under Pressure" (2021): one fingertip over a surface at 0.05, 0.075 and 0.1 m/s in eight directions,
and turned at 1 rad/s. Each stroke comes down onto the surface, rests, slides through the middle of the place,
rests, and goes up again; the way to the next leads through the air.

A stroke is pressed by a depth beyond the first touch, or comes down until a force is felt and keeps to the
depth that it found there. Over a curved surface it follows the arc: the fingertip goes up and down with the
surface under it. It is not turned: that it lies flat on a slope is up to the finger, which has to give way.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from types import MappingProxyType
from typing import Final

import numpy as np

from flows.lab.collection.arm_path import (
    Extent,
    Line,
    Place,
    Pose,
    Slide,
    Step,
    Tare,
    Touchdown,
    Trace,
    Wait,
    beside,
    heading,
)
from flows.lab.collection.surfaces import Surface
from flows.learn.splits import TURNS
from operators.errors import ParameterError

_DIRECTIONS: Final = 8
DEEPEST: Final = 0.006  # m beyond the first touch, that a plan may go


@dataclass(frozen=True, slots=True)
class Stroke:
    """One touch of the surface."""

    direction_deg: float  # in the fingertip's plane, anticlockwise from x
    speed: float  # m/s; rad/s of a rotation, anticlockwise
    spins: bool
    approach: tuple[Step, ...]  # through the air, and down
    contact: tuple[Step, ...]
    retreat: tuple[Step, ...]
    depth: float  # m beyond the first touch; the deepest where a force is sought

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
    clearance: float  # m above the surface's middle, in the air
    air: Wait  # for the baseline
    strokes: tuple[Stroke, ...]
    split: str
    depth: float | None  # m, by which it presses beyond the first touch; None: with a force
    force: float | None  # N

    @property
    def steps(self) -> tuple[Step, ...]:
        """Its path from anywhere; it ends in the air."""
        return self.begin, self.air, *chain.from_iterable(stroke.steps for stroke in self.strokes)


_POSITIVE: Final = (
    *("time", "turn", "air", "clearance", "travel", "press", "acceleration", "spin"),
    *("deepest", "near", "touch", "tare"),
)


@dataclass(frozen=True, slots=True)
class StrokePlan:
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
    force: float | None = None  # N, that it is pressed with instead
    deepest: float = 0.004  # m beyond the first touch, where the force has to be felt at the latest
    near: float = 0.001  # m above the surface, from where the force is sought
    touch: float = 0.002  # m/s, meanwhile; the force goes on growing until the arm stands
    tare: float = 0.2  # s in the air, to learn what force is told when nothing is touched
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
        for name in _POSITIVE:
            if not getattr(self, name) > 0:
                raise ParameterError("StrokePlan", name, getattr(self, name), "above 0")
        for name in ("repeats", "rotations", "rounds", "depth", "rest"):
            if not getattr(self, name) >= 0:
                raise ParameterError("StrokePlan", name, getattr(self, name), "0 or above")
        for name in ("depth", "deepest"):
            if not getattr(self, name) <= DEEPEST:
                must_be = f"at most {1000 * DEEPEST:g} mm, {DEEPEST} m: a fingertip gives way by a few mm"
                raise ParameterError("StrokePlan", name, getattr(self, name), must_be)
        if self.force is not None and not self.force > 0:
            raise ParameterError("StrokePlan", "force", self.force, "above 0 N")
        if self.near > self.clearance:
            raise ParameterError(
                "StrokePlan", "near", self.near, f"at most the clearance, {self.clearance} m"
            )
        if not all(0 < speed < 0.3 for speed in self.speeds):  # noqa: PLR2004 - the label's limit
            raise ParameterError("StrokePlan", "speeds", self.speeds, "above 0 and below 0.3 m/s")

    def sessions(self, surfaces: Sequence[Surface], seed: int) -> list[Session]:
        """All sessions, surface by surface; the order of directions, and the splits, are drawn.

        Like sessions (of a surface and a speed) are split by turns, so that each split has its share.

        Raises:
            ParameterError: if there is nothing to do, or a stroke goes too far over the side of a surface.
        """
        random = np.random.default_rng(seed)
        speeds = [speed for speed in self.speeds for _ in range(self.repeats)] + [None] * self.rotations
        if not (surfaces and speeds and self.rounds):
            raise ParameterError("StrokePlan", "sessions", 0, "1 or more")
        counted, sessions, first = dict[str, int](), list[Session](), int(random.integers(len(TURNS)))
        for surface in surfaces:
            for speed in speeds:
                kind = "rotation" if speed is None else f"{1000 * speed:03.0f}"
                group = f"{surface.curvature}-{kind}"
                counted[group] = counted.get(group, 0) + 1
                strokes = tuple(self._strokes(surface, speed, random))
                sessions.append(
                    Session(
                        f"{group}-{counted[group]:02d}",
                        surface,
                        speed,
                        self._through_air(surface, 0.0, 0.0),
                        self.clearance,
                        Wait(self.air),
                        strokes,
                        TURNS[(first + len(sessions)) % len(TURNS)],
                        self.depth if self.force is None else None,
                        self.force,
                    )
                )
        return sessions

    @property
    def _deep(self) -> float:
        """How far a stroke is planned to go beyond the first touch, m."""
        return self.depth if self.force is None else self.deepest

    def _strokes(
        self, surface: Surface, speed: float | None, random: np.random.Generator
    ) -> Iterator[Stroke]:
        for _ in range(self.rounds):
            for number, direction in enumerate(random.permutation(_DIRECTIONS).tolist()):
                if speed is None:
                    yield self._rotation(surface, self.spin if number % 2 else -self.spin)
                else:
                    yield self._translation(surface, 45.0 * direction, speed)

    def _rotation(self, surface: Surface, spin: float) -> Stroke:
        slide = Slide(heading(surface.place, (0.0, 0.0, 0.0), spin), self.turn, self.spin_acceleration)
        ramp = abs(spin) / self.spin_acceleration
        angle = spin * (self.turn if ramp <= self.turn else self.turn**2 / ramp)
        begin = replace(surface, place=beside(surface.place, yaw=-angle / 2))
        end = replace(surface, place=slide.end(begin.place))
        return Stroke(
            0.0,
            spin,
            spins=True,
            approach=self._approach(begin, 0.0, 0.0),
            contact=(Wait(self.rest), slide, Wait(self.rest)),
            retreat=(self._retreat(end, 0.0, 0.0),),
            depth=self._deep,
        )

    def _translation(self, surface: Surface, direction_deg: float, speed: float) -> Stroke:
        along, half = math.radians(direction_deg), speed * self.time / 2
        x, y = half * math.cos(along), half * math.sin(along)
        places = [surface.at(part * x, part * y, self._deep) for part in surface.bends(x, y)]
        slide: Step
        if len(places) > 1:
            slide = Trace(tuple(place[:3] for place in places), speed, self.acceleration)
        else:  # by its end: the controller keeps to it, however late we are
            slide = Line(places[0], speed, self.acceleration)
        return Stroke(
            direction_deg,
            speed,
            spins=False,
            approach=self._approach(surface, -x, -y),
            contact=(Wait(self.rest), slide, Wait(self.rest)),
            retreat=(self._retreat(surface, x, y),),
            depth=self._deep,
        )

    def _approach(self, surface: Surface, x: float, y: float) -> tuple[Step, ...]:
        """Through the air to above a point beside the middle (m), and down onto it."""
        above = self._through_air(surface, x, y)
        if self.force is None:
            return above, Line(surface.at(x, y, self.depth), self.press, self.acceleration)
        near, deepest = surface.at(x, y, -self.near), surface.at(x, y, self.deepest)
        way: Place = deepest[0] - near[0], deepest[1] - near[1], deepest[2] - near[2]
        return (
            above,
            Tare(self.tare),
            Line(near, self.press, self.acceleration),
            Touchdown(way, self.force, self.touch, self.acceleration),
        )

    def _retreat(self, surface: Surface, x: float, y: float) -> Line:
        return replace(self._through_air(surface, x, y), speed=self.press)

    def _through_air(self, surface: Surface, x: float, y: float) -> Line:
        """The way to above a point beside the middle (m), all as high: so it leads over the middle, too."""
        return Line(beside(surface.place, (x, y, -self.clearance)), self.travel, self.acceleration)


PLANS: Final[Mapping[str, StrokePlan]] = MappingProxyType(
    {"paper": StrokePlan(), "tiny": StrokePlan(speeds=(0.05,), repeats=1, rotations=1, rounds=1, rest=0.3)}
)


def named(name: str) -> StrokePlan:
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

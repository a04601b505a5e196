"""A scene, declared: what the fingertip touches, how the arm moves it, and what goes wrong meanwhile.

A scene costs what it names: terms that are zero or absent are not computed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import repeat
from math import sqrt
from typing import Final, Literal, Protocol, TypeAlias

import numpy as np

from connectors.sim.physics_parameters import Parameters
from operators.batch import Flags, Reals, Times, s
from operators.errors import ParameterError

Curvature: TypeAlias = Literal["plane", "sphere", "cylinder_x", "cylinder_y"]
RADIUS: Final = 0.06  # m, of curved surfaces unless a scene says otherwise
NOISE: Final = 0.6  # counts, standard deviation; unloaded cells of real fingertips have 0.43 to 0.7

MotionKind: TypeAlias = Literal["translation", "rotation", "hold", "tap", "lift"]


@dataclass(frozen=True, slots=True)
class Move:
    """One episode: the arm stands still for `rest`, moves, and has stopped at its end.

    Raises:
        ParameterError: if it stands still for all of its length, or longer.

    >>> Move("translation", seconds=0.9, rest=0.3, direction_deg=45, speed=0.05).axis
    'oblique'
    """

    motion: MotionKind
    seconds: float  # whole length
    rest: float = 0.0  # s of standing still that it begins with
    direction_deg: float = 0.0  # in the fingertip's plane, anticlockwise from x
    speed: float = 0.0  # m/s along the direction; rad/s of a rotation, anticlockwise
    force: float | None = None  # N, normal, approached smoothly over `settle`; None: as it was
    settle: float = 0.3  # s
    tap: float = 0.0  # N, peak of a 10 ms push along the direction, after the rest

    def __post_init__(self) -> None:
        if not 0 <= self.rest < self.seconds:
            raise ParameterError("Move", "rest", self.rest, f"at least 0 and below its {self.seconds} s")

    @property
    def axis(self) -> Literal["primary", "oblique"]:
        """Whether it goes along an axis of the fingertip or across both."""
        return "oblique" if self.direction_deg % 90 else "primary"


class Plan(Protocol):
    """What the arm does, move after move."""

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """The moves in order; they may go on for ever."""
        ...


@dataclass(frozen=True, slots=True)
class Moves:
    """A plan that is written out."""

    steps: tuple[Move, ...]

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """The steps in order."""
        del random
        return iter(self.steps)


@dataclass(frozen=True, slots=True)
class Strokes:
    """Strokes in eight shuffled directions, for ever.

    Each round has its own speed and grip and ends where it began. The fingertip starts in the air, so that a
    baseline can be taken.
    """

    air: float = 1.2  # s before the first contact
    force: float = 2.0  # N, median of the grip
    force_spread: float = 0.6  # of its logarithm; the paper's recordings press with 0.5 to 8 N
    speeds: tuple[float, ...] = (0.05, 0.075, 0.1)  # m/s
    stroke: tuple[float, float] = (0.5, 0.7)  # s, shortest and longest
    pause: tuple[float, float] = (0.4, 1.2)  # s, shortest and longest

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """Air, then rounds of approach and eight strokes."""
        yield Move("hold", self.air, force=0.0)
        while True:
            force = self.force * float(np.exp(self.force_spread * random.standard_normal()))
            yield Move("hold", float(random.uniform(0.8, 1.5)), force=force)
            speed, length = float(random.choice(self.speeds)), float(random.uniform(*self.stroke))
            for direction in random.permutation(8):
                pause = float(random.uniform(*self.pause))
                yield Move("translation", pause + length, pause, 45.0 * int(direction), speed)


@dataclass(frozen=True, slots=True)
class Commanded:
    """Stands still, in contact, and moves only when the hand is told to, for ever."""

    force: float = 0.0  # N, until it is commanded; approached within 0.3 s

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """One minute of holding after the other."""
        del random
        return repeat(Move("hold", 60.0, force=self.force))


@dataclass(frozen=True, slots=True)
class Timing:
    """When a stream samples the world, and what its stamps make of it.

    A sample taken at t (s) is stamped ``t + latency + jitter + offset + drift * t``.

    Raises:
        ParameterError: on a rate that is not above 0, or a share that is none.
    """

    rate: float  # Hz
    latency: float = 0.0  # s, from the instant to its stamp
    jitter: float = 0.0  # s, standard deviation of the stamps; their order is kept
    offset: float = 0.0  # s, error of the stream's clock
    drift: float = 0.0  # s/s, error of the clock's rate
    dropped: float = 0.0  # share of samples that never arrive

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ParameterError("Timing", "rate", self.rate, "above 0 Hz")
        if not 0 <= self.dropped < 1:
            raise ParameterError("Timing", "dropped", self.dropped, "at least 0 and below 1")


@dataclass(frozen=True, slots=True)
class Faults:
    """What is wrong with the barometers."""

    dead: tuple[int, ...] = ()  # do not answer
    stuck: tuple[int, ...] = ()  # repeat their first reading
    floored: tuple[int, ...] = ()  # read 0
    gain: tuple[float, ...] = ()  # (6,) factors of the response
    offset: tuple[float, ...] = ()  # (6,) counts
    drift: tuple[float, ...] = ()  # (6,) counts/s


@dataclass(frozen=True, slots=True)
class Vibration:
    """A shaking of the arm that its encoders do not see."""

    amplitude: float = 1e-4  # m
    frequency: float = 6.5  # Hz; the paper's recordings show 6.5 and 12
    direction_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that a simulated recording depends on besides its seed."""

    plan: Plan = field(default_factory=Strokes)
    curvature: Curvature = "plane"
    radius: float = RADIUS  # m, of a curved surface
    apex: tuple[float, float] = (0.0, 0.0)  # m, where on the pad a curved surface is highest
    tilt: tuple[float, float] = (0.0, 0.0)  # rad, slope along x and y at which the pad is held
    offset: tuple[float, float] = (0.0, 0.0)  # m, from the TCP (rotations turn about it) to the pad's centre
    acceleration: float = 1.0  # m/s2 of the arm at a stroke's ends
    spin_acceleration: float = 10.0  # rad/s2
    force_rate: float = 50.0  # N/s that a commanded grip force changes by; assumed
    vibration: Vibration | None = None
    touch: Timing = Timing(100.0)
    motion: Timing = Timing(125.0, latency=0.07)
    faults: Faults = Faults()
    parameters: Parameters = field(default_factory=Parameters)

    @property
    def curvatures(self) -> tuple[float, float]:
        """Of the surface, along x and along y (1/m)."""
        k = 1 / self.radius
        return {"plane": (0.0, 0.0), "sphere": (k, k), "cylinder_x": (0.0, k), "cylinder_y": (k, 0.0)}[
            self.curvature
        ]


def commanded_scene(curvature: Curvature = "plane", radius: float = RADIUS) -> Scene:
    """Return a scene whose arm waits in the air for commands and whose cells have the noise of real ones.

    Args:
        curvature: Shape of the surface (default "plane").
        radius: Radius of a curved surface (default 0.06 m).
    """
    return Scene(Commanded(), curvature, radius, parameters=Parameters(noise=NOISE))


def surface_drop(curvatures: tuple[float, float], x: float, y: float) -> float:
    """How far a surface falls away below its highest point, m.

    Beyond the edge of the body, where there is none, it falls on, so that nothing is touched there.

    Args:
        curvatures: Along x and along y, 1/m: both alike of a sphere, one of them 0 of a cylinder.
        x: From the highest point, m.
        y: The same.

    >>> round(surface_drop((1 / 0.06, 1 / 0.06), 0.03, 0.0), 6)
    0.008038
    >>> surface_drop((0.0, 1 / 0.06), 0.03, 0.0)
    0.0
    """
    across = curvatures[0] * x * x + curvatures[1] * y * y  # m
    return across / (1 + sqrt(max(0.0, 1 - max(curvatures) * across)))


_BEGINNING: Final = int(np.iinfo(np.int64).min)


class Sampler:
    """Counts the samples of one stream."""

    def __init__(self, timing: Timing, random: np.random.Generator) -> None:
        self.timing = timing
        self._jitter, self._loss = random.spawn(2)
        self._taken = 0
        self._newest = _BEGINNING  # ns

    def instants(self, samples: int) -> Reals:
        """True instants (k,) (s since the run began) of the next samples."""
        return np.arange(self._taken, self._taken + samples) / self.timing.rate

    def stamp(self, samples: int) -> tuple[Times, Flags]:
        """Take the next samples: their stamps (k,) (ns since the run began), and which of them arrive."""
        t, timing = self.instants(samples), self.timing
        self._taken += samples
        stamps = t + timing.latency + timing.offset + timing.drift * t
        arrive = np.ones(samples, np.bool_)
        if timing.jitter:
            stamps += timing.jitter * self._jitter.standard_normal(samples)
        if timing.dropped:
            arrive = self._loss.random(samples) >= timing.dropped
        time = np.maximum.accumulate(np.maximum(np.rint(stamps * s).astype(np.int64), self._newest))
        self._newest = int(time[-1])
        return time, arrive

"""Declaration of a scene: surface, arm motion, timing, faults, vibration and physical constants.

Terms that are zero have no effect.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import exp, sqrt
from typing import Final

import numpy as np

from operators.batch import Curvature, Flags, MotionKind, Reals, Times, s
from operators.errors import ParameterError

ENDLESS: Final = 1 << 62  # rounds


@dataclass(frozen=True, slots=True)
class Move:
    """One episode: the arm rests, moves, and stops by the end.

    Raises:
        ParameterError: if the rest is negative or not shorter than the move.
    """

    motion: MotionKind
    seconds: float  # total duration
    rest: float = 0.0  # s of standstill at the start
    direction_deg: float = 0.0  # in the fingertip's plane, anticlockwise from x
    speed: float = 0.0  # m/s along the direction; rad/s of a rotation, anticlockwise
    force: float | None = None  # N, normal, reached smoothly within `settle`; None for no change
    settle: float = 0.3  # s
    tap: float = 0.0  # N, peak of a 10 ms external force along the direction, after the rest

    def __post_init__(self) -> None:
        if not 0 <= self.rest < self.seconds:
            raise ParameterError("Move", "rest", self.rest, f"at least 0 and below its {self.seconds} s")


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniformly distributed."""
    return float(low * (high / low) ** random.uniform())


def log_normal(random: np.random.Generator, spread: float) -> float:
    """Draw from a log-normal distribution with the median 1."""
    return exp(spread * random.standard_normal())


def _draw_duration(random: np.random.Generator, mean: float, spread: float) -> float:
    """Draw from a log-normal distribution with a mean (s); at least 0.1 s."""
    return max(0.1, mean * (log_normal(random, spread) / exp(spread * spread / 2)))


@dataclass(frozen=True, slots=True)
class PaperStrokes:
    """Plan of strokes or rotations as in the paper; it starts in the air, for the baseline."""

    speed: float | None = 0.05  # m/s of the strokes; None for rotations at 1 rad/s
    force: float = 2.437  # N, normal force; fit
    stroke: float = 0.66  # s, mean duration of a stroke; fit
    stroke_spread: float = 0.05  # standard deviation of its logarithm
    pause: float = 0.68  # s, mean standstill before a stroke; paper: 54 % of 45 minutes are static
    pause_spread: float = 0.65  # standard deviation of its logarithm; fit to the paper's PSD on 1 s
    rounds: int = 2  # of eight strokes each
    touching: bool = False  # True: the baseline is taken in contact
    disturbed: bool = False  # True: force changes, taps and lifts between strokes

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """Yield air, approach, and strokes with or without disturbances between them."""
        yield Move("hold", 1.2, force=self.force * self.touching, settle=0.01)
        yield Move("hold", float(random.uniform(0.6, 1.0)), force=self.force)
        for _ in range(self.rounds):
            for direction in random.permutation(8):
                pause = _draw_duration(random, self.pause, self.pause_spread)
                length = _draw_duration(random, self.stroke, self.stroke_spread)
                if self.speed is None:
                    yield Move("rotation", pause + length, pause, speed=1.0 if direction % 2 else -1.0)
                else:
                    yield Move("translation", pause + length, pause, 45.0 * int(direction), self.speed)
                if self.disturbed:
                    yield from self._disturb(random)

    def _disturb(self, random: np.random.Generator) -> Iterator[Move]:
        """Yield at most one disturbance without slip: a changed force, a tap, or a lift."""
        grip = float(self.force * np.exp(0.3 * random.standard_normal()))
        match random.choice(4, p=[0.54, 0.30, 0.10, 0.06]):
            case 1:
                seconds, settle = random.uniform([0.5, 0.15], [0.9, 0.5])
                yield Move("hold", float(seconds), force=grip, settle=float(settle))
            case 2:
                heading, fraction = random.uniform([0.0, 0.3], [360.0, 1.0])
                yield Move("tap", 0.5, 0.1, float(heading), tap=float(3.0 * fraction))  # N
            case 3:
                yield Move("lift", 0.5, force=0.0, settle=0.2)
                yield Move("hold", 0.6, force=grip)
            case _:
                return


@dataclass(frozen=True, slots=True)
class Timing:
    """Sampling and timestamps of a stream.

    A sample taken at t (s) has the timestamp ``t + latency + wander + offset``.
    """

    rate: float  # Hz
    latency: float = 0.0  # s, mean time from the sample to its timestamp
    wander: float = 0.0  # s, standard deviation of the latency, which changes within seconds
    offset: float = 0.0  # s, clock offset
    dropped: float = 0.0  # fraction of samples that are lost


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of the barometers, the same for all that respond."""

    dead: int = 0  # number of cells, from 0 on, that do not respond
    gain: float = 1.0  # factor of the response
    offset: float = 0.0  # counts
    drift: float = 0.0  # counts/s


@dataclass(frozen=True, slots=True)
class Vibration:
    """A vibration of the arm that its encoders do not measure."""

    amplitude: float = 1e-4  # m
    frequency: float = 6.5  # Hz; paper: 6.5 and 12
    direction_deg: float = 0.0


NO_VIBRATION: Final = Vibration(0.0)


@dataclass(frozen=True, slots=True)
class Parameters:
    """Constants of one fingertip on one material, in SI units.

    Sources: *geometry* of the device; *paper*, "Under Pressure" (2021); *convergence*, a finer value changes
    nothing; *fit*, all together by `make scene-fit`: the paper's TCN, trained on real recordings, detects
    slip in the simulated signal, and statistics, relaxation and spectrum match real ones. Fitted values are
    effective: they describe the whole finger, not a sample of rubber.

    >>> Parameters(columns=6, rows=4).columns
    6
    """

    # pad
    width: float = 0.024  # m, along x; geometry
    height: float = 0.016  # m, along y; geometry
    columns: int = 8  # nodes along x; convergence
    rows: int = 6  # nodes along y; convergence
    normal_stiffness: float = 9.023e7  # Pa/m; fit
    shear_stiffness: float = 2.315e7  # Pa/m; fit

    # touched material
    static_friction: float = 1.285  # fit
    kinetic_friction: float = 0.5843  # fit
    stribeck_speed: float = 0.3098  # m/s; fit
    texture: float = 0.5138  # depth of the friction's modulation along the path; fit
    texture_lengths: tuple[float, float] = (0.007243, 0.004291)  # m; fit
    unevenness: float = 0.0  # depth of the normal force's modulation along the arm's path
    uneven_lengths: tuple[float, float] = (0.04, 0.023)  # m; assumed

    # finger that carries the pad
    mass: float = 0.1031  # kg; fit
    stiffness: float = 1629.0  # N/m in the pad's plane; fit: resonance at 20 Hz in the air
    damping: float = 0.03047  # damping ratio; fit
    inertia: float = 6e-5  # kg m2 about the pad's normal; assumed, without effect on the scores
    twist_stiffness: float = 0.55  # N m/rad about the pad's normal; assumed: resonance at 15 Hz
    tilt_stiffness: float = 0.8029  # N m/rad about x and about y; fit
    lever: float = 0.05025  # m, from the pad's face to the tilt axes; fit

    # barometers under the rubber
    pitch_x: float = 0.008403  # m between cells; fit
    pitch_y: float = 0.006956  # m between rows; fit
    depth: float = 0.00642  # m of rubber over the cells; fit
    shear_gain: float = 3.561  # factor of the half-space's response to shear; fit
    sensitivity: float = 0.01364  # counts/Pa; fit, below the datasheet's 0.016 (1023 counts over 65 kPa)
    relaxation: float = 0.0619  # fraction of the response that is lost per decade of time; fit
    noise: float = 0.6  # counts, standard deviation; paper: 0.43 to 0.7 of unloaded cells
    glitches: float = 0.0  # 1/s, short disturbances of all cells at once, of some counts
    rest_lowest: int = 420  # counts of an unloaded cell; paper: cells reach 0 at 420 to 502 counts below rest
    rest_highest: int = 502  # counts

    # simulation
    step: float = 0.001  # s; convergence


@dataclass(frozen=True, slots=True)
class Scene:
    """All parameters of a simulated recording except its seed."""

    plan: PaperStrokes | tuple[Move, ...] = PaperStrokes(rounds=ENDLESS)
    curvature: Curvature = "plane"
    radius: float = 0.06  # m, of a curved surface
    apex: tuple[float, float] = (0.0, 0.0)  # m, highest point of a curved surface on the pad
    tilt: tuple[float, float] = (0.0, 0.0)  # rad, slope of the pad along x and y
    offset: tuple[float, float] = (0.0, 0.0)  # m, from the TCP, the axis of rotations, to the pad's centre
    acceleration: float = 1.0  # m/s2 of the arm at the ends of a stroke
    vibration: Vibration = NO_VIBRATION
    touch: Timing = Timing(100.0)
    motion: Timing = Timing(125.0, latency=0.07)
    faults: Faults = Faults()
    parameters: Parameters = field(default_factory=Parameters)

    @property
    def curvatures(self) -> tuple[float, float]:
        """Curvatures of the surface along x and y (1/m)."""
        k = 1 / self.radius
        return {"plane": (0.0, 0.0), "sphere": (k, k), "cylinder_x": (0.0, k), "cylinder_y": (k, 0.0)}[
            self.curvature
        ]

    def moves(self, seed: int) -> Iterator[tuple[float, Move]]:
        """Yield each move of the plan with its start (s)."""
        start = 0.0
        random = np.random.default_rng([seed, 0])
        for move in self.plan if isinstance(self.plan, tuple) else self.plan.moves(random):
            yield start, move
            start += move.seconds


@dataclass(frozen=True, slots=True)
class Travel:
    """Motion over a distance, from rest to rest, with a trapezoidal velocity profile.

    >>> Travel(2.0, distance=0.05, speed=0.1, acceleration=0.5).end
    2.7
    """

    start: float  # s since the run began
    distance: float = 0.05  # m
    speed: float = 0.05  # m/s, maximum
    acceleration: float = 0.5  # m/s2

    @property
    def _ramp(self) -> float:
        """Duration of acceleration and of deceleration (s)."""
        return min(self.speed / self.acceleration, sqrt(self.distance / self.acceleration))

    @property
    def end(self) -> float:
        """Instant of the standstill at the end (s since the run began)."""
        return self.start + self._ramp + self.distance / (self.acceleration * self._ramp)

    def at(self, t: Reals) -> tuple[Reals, Reals]:
        """Return distance and speed at instants (k,) (s): (k,) m and (k,) m/s."""
        gone, ramp = np.clip(t - self.start, 0.0, self.end - self.start), self._ramp
        left = self.end - self.start - gone
        cruise = np.clip(gone - ramp, 0.0, self.end - self.start - 2 * ramp)
        up, down = np.minimum(gone, ramp), np.minimum(left, ramp)
        distance = self.acceleration * (up**2 / 2 + ramp * cruise + (ramp**2 - down**2) / 2)
        return distance, self.acceleration * np.minimum(up, down)


def surface_drop(curvatures: tuple[float, float], x: float, y: float) -> float:
    """Return the depth (m) of a surface below its highest point.

    Beyond the edge of a sphere or cylinder the depth keeps growing, so that nothing is touched there.

    Args:
        curvatures: Curvatures along x and y (1/m): equal for a sphere, one of them 0 for a cylinder.
        x: Distance from the highest point along x (m).
        y: Distance from the highest point along y (m).

    >>> round(surface_drop((1 / 0.06, 1 / 0.06), 0.03, 0.0), 6)
    0.008038
    >>> surface_drop((0.0, 1 / 0.06), 0.03, 0.0)
    0.0
    """
    across = curvatures[0] * x * x + curvatures[1] * y * y  # m
    return across / (1 + sqrt(max(0.0, 1 - max(curvatures) * across)))


class Sampler:
    """Generator of the sampling instants and timestamps of one stream."""

    def __init__(self, timing: Timing, random: np.random.Generator) -> None:
        self.timing = timing
        _, self._loss, self._slow = random.spawn(3)
        self._kept = exp(-1 / timing.rate)  # part of a latency's deviation after a sample; 1/e after 1 s
        self._left = self._kept * self._slow.standard_normal(1)  # of the latest deviation
        self._taken = 0
        self._latest = int(np.iinfo(np.int64).min)  # ns

    def instants(self, samples: int) -> Reals:
        """Return the true instants (k,) (s since the run began) of the next samples."""
        return np.arange(self._taken, self._taken + samples) / self.timing.rate

    def stamp(self, samples: int) -> tuple[Times, Flags]:
        """Take the next samples; return timestamps (k,) (ns since the run began) and which arrive (k,)."""
        t, timing = self.instants(samples), self.timing
        self._taken += samples
        stamps = t + timing.latency + timing.offset
        arrive = np.ones(samples, np.bool_)
        if timing.wander:
            stamps += timing.wander * self._wandered(samples)
        if timing.dropped:
            arrive = self._loss.random(samples) >= timing.dropped
        time = np.maximum.accumulate(np.maximum(np.rint(stamps * s).astype(np.int64), self._latest))
        self._latest = int(time[-1])
        return time, arrive

    def _wandered(self, samples: int) -> Reals:
        """Return deviations (k,) of the next latencies: an Ornstein-Uhlenbeck process of unit variance."""
        from scipy.signal import lfilter

        noise = sqrt(1 - self._kept**2) * self._slow.standard_normal(samples)
        found, self._left = lfilter([1.0], [1.0, -self._kept], noise, zi=self._left)
        return np.asarray(found)

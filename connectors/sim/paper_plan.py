"""Recording plan of the paper ("Under Pressure", 2021) as simulated scenes, and a wider variation of it.

Each recording drags one fingertip over one surface at one speed, twice in each of eight directions, or
rotates it in both directions, with pauses; the arm always vibrates. The defaults give 45 minutes, 54 % of
them static. In the wider variation the grip also changes between strokes, or the finger is tapped or lifted.
Split by recording, never by window.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Final, TypeAlias, cast

import numpy as np

from connectors.sim.scene import Curvature, Move, Parameters, Scene, Timing, Vibration

SHORTEST: Final = 0.1  # s, of a stroke and of a standstill
Variation: TypeAlias = Callable[[Scene, np.random.Generator], Scene]


@dataclass(frozen=True, slots=True)
class PaperStrokes:
    """Moves of one recording."""

    speed: float | None = 0.05  # m/s of the strokes; None for rotations at 1 rad/s
    force: float = 2.0  # N, normal force
    regrip: float = 0.3  # standard deviation of the logarithm of a changed force
    tap: float = 3.0  # N, largest peak of a tap
    stroke: float = 0.66  # s, mean duration of a stroke
    stroke_spread: float = 0.05  # standard deviation of its logarithm
    pause: float = 0.68  # s, mean standstill before a stroke
    pause_spread: float = 0.65  # standard deviation of its logarithm
    rounds: int = 2  # of eight strokes each
    touching: bool = False  # True: the baseline is taken in contact
    disturbed: bool = False  # True: force changes, taps and lifts between strokes

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """Yield air, approach, and strokes with or without disturbances between them."""
        yield Move("hold", 1.2, force=self.force * self.touching, settle=0.01)
        yield Move("hold", float(random.uniform(0.6, 1.0)), force=self.force)
        for _ in range(self.rounds):
            for direction in random.permutation(8):
                pause = max(SHORTEST, self.pause * _around(random, self.pause_spread))
                length = max(SHORTEST, self.stroke * _around(random, self.stroke_spread))
                if self.speed is None:
                    yield Move("rotation", pause + length, pause, speed=1.0 if direction % 2 else -1.0)
                else:
                    yield Move("translation", pause + length, pause, 45.0 * int(direction), self.speed)
                if self.disturbed:
                    yield from self._disturb(random)

    def _disturb(self, random: np.random.Generator) -> Iterator[Move]:
        """Yield at most one disturbance without slip: a changed force, a tap, or a lift."""
        grip = float(self.force * np.exp(self.regrip * random.standard_normal()))
        match random.choice(4, p=[0.54, 0.30, 0.10, 0.06]):
            case 1:
                seconds, settle = random.uniform([0.5, 0.15], [0.9, 0.5])
                yield Move("hold", float(seconds), force=grip, settle=float(settle))
            case 2:
                heading, fraction = random.uniform([0.0, 0.3], [360.0, 1.0])
                yield Move("tap", 0.5, 0.1, float(heading), tap=float(self.tap * fraction))
            case 3:
                yield Move("lift", 0.5, force=0.0, settle=0.2)
                yield Move("hold", 0.6, force=grip)
            case _:
                return


@dataclass(frozen=True, slots=True)
class PaperPlan:
    """Recordings over surfaces, speeds and repeats.

    >>> len(list(PaperPlan(repeats=1, rotations=0).scenes(seed=0)))
    12
    """

    surfaces: tuple[Curvature, ...] = ("plane", "sphere", "cylinder_y", "cylinder_x")
    speeds: tuple[float, ...] = (0.05, 0.075, 0.1)  # m/s; paper
    repeats: int = 9  # recordings per surface and speed; paper: 45 minutes in total
    rotations: int = 5  # recordings per surface; paper, Table III: about a tenth
    rounds: int = 2  # of eight strokes per recording
    force: float = 2.437  # N, normal force; fit
    vibration: float = 1.393e-4  # m, mean amplitude of the arm's vibration; fit
    stroke: float = 0.66  # s, duration of a stroke; fit
    pause: float = 0.68  # s, mean standstill before a stroke; paper: 54 % of 45 minutes are static
    pause_spread: float = 0.65  # standard deviation of its logarithm; fit to the paper's PSD on 1 s
    tilt: tuple[float, float] = (-0.1558, -0.1104)  # rad, slope of the pad on the plane along x and y; fit
    pivot: float = 0.03879  # m, from the pad's centre to the axis of rotations; fit
    latency: float = 0.08857  # s, mean delay of the arm's velocity after the barometers; fit
    wander: float = 0.056  # s, standard deviation of that delay; fit to the paper's TCN
    acceleration: float = 0.4735  # m/s2 at the ends of a stroke; fit
    # uneven so that the load moves at 2 Hz in slip, as in a real trace
    parameters: Parameters = field(default_factory=partial(Parameters, unevenness=0.3))
    vary: Variation | None = None  # applied to the scene of each recording

    def scenes(self, seed: int) -> Iterator[Scene]:
        """Yield the scene of each recording, alternating between surfaces; deterministic for a seed."""
        speeds = [*self.speeds * self.repeats, *[None] * self.rotations]
        for number, (speed, surface) in enumerate(product(speeds, self.surfaces)):
            yield self._scene(np.random.default_rng([seed, 3, number]), surface, speed)

    def _scene(self, random: np.random.Generator, surface: Curvature, speed: float | None) -> Scene:
        pivot_angle, heading = random.uniform(0.0, 360.0, 2)
        amplitude = self.vibration * random.uniform(0.3, 1.7)
        scene = Scene(
            PaperStrokes(
                speed,
                self.force,
                stroke=self.stroke,
                pause=self.pause,
                pause_spread=self.pause_spread,
                rounds=self.rounds,
            ),
            surface,
            offset=(
                self.pivot * math.cos(math.radians(pivot_angle)),
                self.pivot * math.sin(math.radians(pivot_angle)),
            ),
            tilt=self.tilt if surface == "plane" else (0.0, 0.0),
            acceleration=self.acceleration,
            vibration=Vibration(float(amplitude), float(random.choice([6.5, 12.0])), float(heading)),
            motion=Timing(125.0, latency=self.latency, wander=self.wander),
            parameters=self.parameters,
        )
        return self.vary(scene, random) if self.vary else scene


SLOWEST, FASTEST = 0.005, 0.15  # m/s, varied speeds of strokes
STROKES = (0.3, 3.0)  # s, varied mean duration of strokes
PAUSES = (0.25, 2.0)  # s, varied mean standstill before a stroke
TILT_SPREAD = 0.008  # rad, standard deviation of the pad's tilt about x and y
APEX_SPREAD = 0.0018  # m, standard deviation of the apex of a curved surface


def varied(scene: Scene, random: np.random.Generator) -> Scene:
    """Return a scene of the plan with a random material, fingertip, pose and speed.

    A detector that is trained on one finger and one material overfits to their friction and resonance. The
    variation around the fitted parameters is wider than their uncertainty (domain randomisation: Tobin et
    al., 2017).
    """
    plan = cast("PaperStrokes", scene.plan)
    plan = replace(
        plan,
        force=plan.force * _factor(random, 0.6),
        stroke=_log_uniform(random, *STROKES),
        stroke_spread=0.4,
        pause=_log_uniform(random, *PAUSES),
        disturbed=True,
    )
    if plan.speed is not None and random.random() < 0.4:
        plan = replace(plan, speed=_log_uniform(random, SLOWEST, FASTEST))
    tilt, apex = TILT_SPREAD * random.standard_normal(2), APEX_SPREAD * random.standard_normal(2)
    vibration = cast("Vibration", scene.vibration)
    return replace(
        scene,
        plan=plan,
        tilt=(scene.tilt[0] + float(tilt[0]), scene.tilt[1] + float(tilt[1])),
        apex=(float(apex[0]), float(apex[1])),
        vibration=replace(
            vibration,
            amplitude=vibration.amplitude * _factor(random, 0.6),
            frequency=float(random.uniform(4.0, 16.0)),
        ),
        parameters=_material(scene.parameters, random),
    )


def calm(scene: Scene, random: np.random.Generator) -> Scene:
    """Return a scene of the plan with a quiet hand, a smooth uneven surface and another kind of fingertip.

    Slip then shows in slow changes of load only, as on real strokes of hands with other fingertips.
    """
    scene = varied(scene, random)
    p, plan = scene.parameters, cast("PaperStrokes", scene.plan)
    length = _log_uniform(random, 0.5, 4.0)
    return replace(
        scene,
        plan=replace(
            plan,
            speed=plan.speed and _log_uniform(random, SLOWEST, 0.1),
            stroke=_log_uniform(random, 0.4, 4.0),
            pause=_log_uniform(random, 0.5, 6.0),
            touching=True,
            disturbed=False,
        ),
        vibration=replace(cast("Vibration", scene.vibration), amplitude=_log_uniform(random, 1e-7, 1e-5)),
        parameters=replace(
            p,
            static_friction=p.kinetic_friction * float(random.uniform(1.0, 1.1)),
            texture=p.texture * float(random.uniform(0.0, 0.3)),
            unevenness=float(random.uniform(0.3, 0.95)),
            uneven_lengths=(p.uneven_lengths[0] * length, p.uneven_lengths[1] * length),
            damping=_log_uniform(random, 0.05, 0.5),
            sensitivity=p.sensitivity * _log_uniform(random, 0.03, 5.0),
            noise=_log_uniform(random, 0.4, 2.5),
            glitches=_log_uniform(random, 0.3, 6.0),
            relaxation=_log_uniform(random, p.relaxation, 0.25),
        ),
    )


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.uniform())


def _factor(random: np.random.Generator, spread: float) -> float:
    """Draw from a log-normal distribution with the median 1."""
    return math.exp(spread * random.standard_normal())


def _around(random: np.random.Generator, spread: float) -> float:
    """Draw from a log-normal distribution with the mean 1."""
    return _factor(random, spread) / math.exp(spread * spread / 2)


def _material(p: Parameters, random: np.random.Generator) -> Parameters:
    kinetic = p.kinetic_friction * _factor(random, 0.35)
    excess = (p.static_friction - p.kinetic_friction) * float(random.uniform(0.0, 1.3))  # at 0 no stick-slip
    grain = _factor(random, 0.35)
    return replace(
        p,
        kinetic_friction=kinetic,
        static_friction=kinetic + excess,
        stribeck_speed=p.stribeck_speed * _factor(random, 0.4),
        texture=min(0.95, p.texture * float(random.uniform(0.2, 1.3))),
        texture_lengths=(
            p.texture_lengths[0] * grain * _factor(random, 0.2),
            p.texture_lengths[1] * grain * _factor(random, 0.2),
        ),
        stiffness=p.stiffness * _factor(random, 0.4),
        mass=p.mass * _factor(random, 0.2),
        damping=p.damping * _factor(random, 0.4),
        tilt_stiffness=p.tilt_stiffness * _factor(random, 0.3),
        sensitivity=p.sensitivity * _factor(random, 0.2),
        shear_gain=p.shear_gain * _factor(random, 0.3),
        unevenness=float(random.uniform(0.0, 0.6)),
    )

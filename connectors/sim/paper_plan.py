"""Recording plan of the paper ("Under Pressure", 2021) as simulated scenes, and a wider variation of it.

Each recording drags one fingertip over one surface at one speed, twice in each of eight directions, or
rotates it in both directions, with pauses; the arm always vibrates. The defaults give 45 minutes, 54 % of
them static. In the wider variation the grip also changes between strokes, or the finger is tapped or lifted.
Split by recording, never by window.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TypeAlias, cast

import numpy as np

from connectors.sim.scene import Curvature, Move, Parameters, Scene, Timing, Vibration

Variation: TypeAlias = Callable[[Scene, np.random.Generator], Scene]


@dataclass(frozen=True, slots=True)
class PaperStrokes:
    """Moves of one recording."""

    speed: float | None = 0.05  # m/s of the strokes; None for rotations at 1 rad/s
    force: float = 2.0  # N, normal force
    regrip: float = 0.3  # standard deviation of the logarithm of a changed force
    tap: float = 3.0  # N, largest peak of a tap
    pause: float = 0.576  # s, mean standstill before a stroke
    rounds: int = 2  # of eight strokes each
    disturbed: bool = False  # True: force changes, taps and lifts between strokes

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """Yield air, approach, and strokes with or without disturbances between them."""
        yield Move("hold", 1.2, force=0.0)
        yield Move("hold", float(random.uniform(0.6, 1.0)), force=self.force)
        for _ in range(self.rounds):
            for direction in random.permutation(8):
                pause = self.pause * float(random.uniform(0.75, 1.25))
                length = float(random.uniform(0.5, 0.7))
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
    force: float = 3.14  # N, normal force; fit
    vibration: float = 1.382e-4  # m, mean amplitude of the arm's vibration; fit
    pause: float = 0.576  # s, mean standstill before a stroke; paper: 54 % of 45 minutes are static
    tilt: tuple[float, float] = (-0.1024, -0.1337)  # rad, slope of the pad on the plane along x and y; fit
    pivot: float = 0.03467  # m, from the pad's centre to the axis of rotations; fit
    latency: float = 0.08653  # s, delay of the arm's velocity after the barometers; fit
    acceleration: float = 0.6478  # m/s2 at the ends of a stroke; fit
    parameters: Parameters = field(default_factory=Parameters)
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
            PaperStrokes(speed, self.force, pause=self.pause, rounds=self.rounds),
            surface,
            offset=(
                self.pivot * math.cos(math.radians(pivot_angle)),
                self.pivot * math.sin(math.radians(pivot_angle)),
            ),
            tilt=self.tilt if surface == "plane" else (0.0, 0.0),
            acceleration=self.acceleration,
            vibration=Vibration(float(amplitude), float(random.choice([6.5, 12.0])), float(heading)),
            motion=Timing(125.0, latency=self.latency),
            parameters=self.parameters,
        )
        return self.vary(scene, random) if self.vary else scene


SLOWEST, FASTEST = 0.005, 0.15  # m/s, varied speeds of strokes
TILT_SPREAD = 0.008  # rad, standard deviation of the pad's tilt about x and y
APEX_SPREAD = 0.0018  # m, standard deviation of the apex of a curved surface


def varied(scene: Scene, random: np.random.Generator) -> Scene:
    """Return a scene of the plan with a random material, fingertip, pose and speed.

    A detector that is trained on one finger and one material overfits to their friction and resonance. The
    variation around the fitted parameters is wider than their uncertainty (domain randomisation: Tobin et
    al., 2017).
    """
    plan = cast("PaperStrokes", scene.plan)
    pause = plan.pause * float(random.uniform(0.4, 1.0))
    plan = replace(plan, force=plan.force * _factor(random, 0.6), pause=pause, disturbed=True)
    if plan.speed is not None and random.random() < 0.4:
        plan = replace(plan, speed=float(np.exp(random.uniform(math.log(SLOWEST), math.log(FASTEST)))))
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


def _factor(random: np.random.Generator, spread: float) -> float:
    """Draw from a log-normal distribution around 1."""
    return math.exp(spread * random.standard_normal())


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
    )

"""The paper's collection plan as scenes: what "Under Pressure" (2021) recorded, on the simulated rig.

Every recording drags one fingertip over one surface at one speed, twice in each of eight directions, or turns
it to and fro; between strokes the grip changes, the finger is tapped or lifted, and the arm always shakes. At
its defaults 45 minutes, 54 % of them static. Split by recording, never by window.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TypeAlias, cast

import numpy as np

from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Curvature, Move, Scene, Timing, Vibration

Variation: TypeAlias = Callable[[Scene, np.random.Generator], Scene]


@dataclass(frozen=True, slots=True)
class PaperStrokes:
    """The moves of one recording."""

    speed: float | None = 0.05  # m/s of its strokes; None: rotations at 1 rad/s
    force: float = 2.0  # N, grip
    regrip: float = 0.3  # spread of the grip's logarithm where it changes
    tap: float = 3.0  # N, the hardest
    rounds: int = 2  # of eight strokes

    def moves(self, random: np.random.Generator) -> Iterator[Move]:
        """Air, approach, and strokes with what comes between them."""
        yield Move("hold", 1.2, force=0.0)
        yield Move("hold", float(random.uniform(0.6, 1.0)), force=self.force)
        for _ in range(self.rounds):
            for direction in random.permutation(8):
                pause, length = float(random.uniform(0.2, 0.3)), float(random.uniform(0.5, 0.7))
                if self.speed is None:
                    yield Move("rotation", pause + length, pause, speed=1.0 if direction % 2 else -1.0)
                else:
                    yield Move("translation", pause + length, pause, 45.0 * int(direction), self.speed)
                yield from self._between(random)

    def _between(self, random: np.random.Generator) -> Iterator[Move]:
        """Nothing, or one thing that is no slip."""
        grip = float(self.force * np.exp(self.regrip * random.standard_normal()))
        match random.choice(4, p=[0.54, 0.30, 0.10, 0.06]):
            case 1:
                seconds, settle = random.uniform([0.5, 0.15], [0.9, 0.5])
                yield Move("hold", float(seconds), force=grip, settle=float(settle))
            case 2:
                heading, share = random.uniform([0.0, 0.3], [360.0, 1.0])
                yield Move("tap", 0.5, 0.1, float(heading), tap=float(self.tap * share))
            case 3:
                yield Move("lift", 0.5, force=0.0, settle=0.2)
                yield Move("hold", 0.6, force=grip)
            case _:
                return


def _unvaried(scene: Scene, random: np.random.Generator) -> Scene:
    del random
    return scene


@dataclass(frozen=True, slots=True)
class PaperPlan:
    """How the recordings of a plan differ from each other.

    >>> len(list(PaperPlan(repeats=1, rotations=0).scenes(seed=0)))
    12
    """

    surfaces: tuple[Curvature, ...] = ("plane", "sphere", "cylinder_y", "cylinder_x")
    speeds: tuple[float, ...] = (0.05, 0.075, 0.1)  # m/s; paper
    repeats: int = 9  # recordings of each surface and speed; paper: 45 minutes in all
    rotations: int = 5  # recordings of each surface; paper: about a tenth, from its Table III
    rounds: int = 2  # of eight strokes in a recording
    force: float = 1.5  # N, grip; fit
    vibration: float = 1.5e-4  # m, mean amplitude of the arm's shaking; fit
    pivot: float = 0.0065  # m, from the pad's centre to what rotations turn about; fit
    latency: float = 0.07  # s, of the arm's velocity against the barometers, times 0.4 to 1.6; fit
    acceleration: float = 0.63  # m/s2 at a stroke's ends; fit
    parameters: Parameters = field(default_factory=Parameters)
    vary: Variation = _unvaried  # each recording's scene, on top of all this

    def scenes(self, seed: int) -> Iterator[Scene]:
        """One scene for each recording, the surfaces by turns; the same seed gives the same ones."""
        speeds = [*self.speeds * self.repeats, *[None] * self.rotations]
        for number, (speed, surface) in enumerate(product(speeds, self.surfaces)):
            yield self._scene(np.random.default_rng([seed, 3, number]), surface, speed)

    def _scene(self, random: np.random.Generator, surface: Curvature, speed: float | None) -> Scene:
        turn, heading = random.uniform(0.0, 360.0, 2)
        shake = self.vibration * random.uniform(0.3, 1.7)
        scene = Scene(
            PaperStrokes(speed, self.force, rounds=self.rounds),
            surface,
            offset=(self.pivot * math.cos(math.radians(turn)), self.pivot * math.sin(math.radians(turn))),
            acceleration=self.acceleration,
            vibration=Vibration(float(shake), float(random.choice([6.5, 12.0])), float(heading)),
            motion=Timing(125.0, latency=float(self.latency * random.uniform(0.4, 1.6))),
            parameters=self.parameters,
        )
        return self.vary(scene, random)


_SLOWEST, _FASTEST = 0.005, 0.15  # m/s, of strokes
_TILT = 0.008  # rad, standard deviation of the pad's slope along x and y
_APEX = 0.0018  # m, standard deviation of where a curved surface is highest


def varied(scene: Scene, random: np.random.Generator) -> Scene:
    """A scene of the collection plan with a material, finger, pose and pace of its own."""
    plan = cast("PaperStrokes", scene.plan)
    plan = replace(plan, force=plan.force * _factor(random, 0.6))
    if plan.speed is not None and random.random() < 0.4:  # noqa: PLR2004 the rest keeps the plan's pace
        plan = replace(plan, speed=float(np.exp(random.uniform(math.log(_SLOWEST), math.log(_FASTEST)))))
    tilt, apex = _TILT * random.standard_normal(2), _APEX * random.standard_normal(2)
    shaking = cast("Vibration", scene.vibration)
    return replace(
        scene,
        plan=plan,
        tilt=(float(tilt[0]), float(tilt[1])),
        apex=(float(apex[0]), float(apex[1])),
        vibration=replace(
            shaking,
            amplitude=shaking.amplitude * _factor(random, 0.6),
            frequency=float(random.uniform(4.0, 16.0)),
        ),
        parameters=_material(scene.parameters, random),
    )


def _factor(random: np.random.Generator, spread: float) -> float:
    """Log-normal around 1."""
    return math.exp(spread * random.standard_normal())


def _material(p: Parameters, random: np.random.Generator) -> Parameters:
    kinetic = p.kinetic_friction * _factor(random, 0.35)
    excess = (p.static_friction - p.kinetic_friction) * float(random.uniform(0.0, 1.3))  # 0: no stick-slip
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

"""Recording plan of the paper ("Under Pressure", 2021) as simulated scenes, and a wider variation of it.

Each recording drags one fingertip over one surface at one speed, twice in each of eight directions, or
rotates it in both directions, with pauses; the arm always vibrates. The defaults give 50 minutes, 55 % of
them static. In the wider variation the grip also changes between strokes, or the finger is tapped or lifted.
Split by recording, never by window.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import TypeAlias, cast

import numpy as np

from connectors.sim.scene import PaperStrokes, Parameters, Scene, Timing, Vibration, log_normal, log_uniform
from operators.batch import Curvature

Variation: TypeAlias = Callable[[Scene, np.random.Generator], Scene]


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
    strokes: PaperStrokes = field(default_factory=PaperStrokes)  # each recording has its own speed
    vibration: float = 1.393e-4  # m, mean amplitude of the arm's vibration; fit
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
            replace(self.strokes, speed=speed),
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
        force=plan.force * log_normal(random, 0.6),
        stroke=log_uniform(random, 0.3, 3.0),
        stroke_spread=0.4,
        pause=log_uniform(random, 0.25, 2.0),
        disturbed=True,
    )
    if plan.speed is not None and random.random() < 0.4:
        plan = replace(plan, speed=log_uniform(random, SLOWEST, FASTEST))
    tilt, apex = TILT_SPREAD * random.standard_normal(2), APEX_SPREAD * random.standard_normal(2)
    return replace(
        scene,
        plan=plan,
        tilt=(scene.tilt[0] + float(tilt[0]), scene.tilt[1] + float(tilt[1])),
        apex=(float(apex[0]), float(apex[1])),
        vibration=replace(
            scene.vibration,
            amplitude=scene.vibration.amplitude * log_normal(random, 0.6),
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
    length = log_uniform(random, 0.5, 4.0)
    return replace(
        scene,
        plan=replace(
            plan,
            speed=plan.speed and log_uniform(random, SLOWEST, 0.1),
            stroke=log_uniform(random, 0.4, 4.0),
            pause=log_uniform(random, 0.5, 6.0),
            touching=True,
            disturbed=False,
        ),
        vibration=replace(scene.vibration, amplitude=log_uniform(random, 1e-7, 1e-5)),
        parameters=replace(
            p,
            static_friction=p.kinetic_friction * float(random.uniform(1.0, 1.1)),
            texture=p.texture * float(random.uniform(0.0, 0.3)),
            unevenness=float(random.uniform(0.3, 0.95)),
            uneven_lengths=(p.uneven_lengths[0] * length, p.uneven_lengths[1] * length),
            damping=log_uniform(random, 0.05, 0.5),
            sensitivity=p.sensitivity * log_uniform(random, 0.03, 5.0),
            noise=log_uniform(random, 0.4, 2.5),
            glitches=log_uniform(random, 0.3, 6.0),
            relaxation=log_uniform(random, p.relaxation, 0.25),
        ),
    )


def _material(p: Parameters, random: np.random.Generator) -> Parameters:
    kinetic = p.kinetic_friction * log_normal(random, 0.35)
    excess = (p.static_friction - p.kinetic_friction) * float(random.uniform(0.0, 1.3))  # at 0 no stick-slip
    grain = log_normal(random, 0.35)
    return replace(
        p,
        kinetic_friction=kinetic,
        static_friction=kinetic + excess,
        stribeck_speed=p.stribeck_speed * log_normal(random, 0.4),
        texture=min(0.95, p.texture * float(random.uniform(0.2, 1.3))),
        texture_lengths=(
            p.texture_lengths[0] * grain * log_normal(random, 0.2),
            p.texture_lengths[1] * grain * log_normal(random, 0.2),
        ),
        stiffness=p.stiffness * log_normal(random, 0.4),
        mass=p.mass * log_normal(random, 0.2),
        damping=p.damping * log_normal(random, 0.4),
        tilt_stiffness=p.tilt_stiffness * log_normal(random, 0.3),
        sensitivity=p.sensitivity * log_normal(random, 0.2),
        shear_gain=p.shear_gain * log_normal(random, 0.3),
        unevenness=float(random.uniform(0.0, 0.6)),
    )

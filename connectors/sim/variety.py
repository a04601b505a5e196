"""Scenes that differ in what no recording plan controls: material, finger, pose and pace.

A detector that is trained on one finger and one material knows their friction and resonance by heart. Here
each recording draws its own (domain randomisation: Tobin et al., 2017), around the fitted ones and wider than
they are known.
"""

import math
from dataclasses import replace
from typing import cast

import numpy as np

from connectors.sim.paper_plan import Recording
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Scene, Vibration

_SLOWEST, _FASTEST = 0.005, 0.15  # m/s, of strokes
_TILT = 0.008  # rad, standard deviation of the pad's slope along x and y
_APEX = 0.0018  # m, standard deviation of where a curved surface is highest


def varied(scene: Scene, random: np.random.Generator) -> Scene:
    """A scene of the collection plan with a material, finger, pose and pace of its own."""
    plan = cast("Recording", scene.plan)
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

"""What it takes to hold an object: the pad's scene, the constants of the grip, and the least force.

The passive fingers are as stiff as the sensorised one; what they and the table are made of is assumed.
"""

import math
from dataclasses import replace
from typing import Final

from connectors.sim.body import GRAVITY, Grip
from connectors.sim.finger import law
from connectors.sim.objects import Object
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Scene

PASSIVE_FRICTION: Final = 0.6  # of the passive fingers on the scene's material; assumed: hard plastic pads
APART: Final = 0.015  # m, the passive fingers from the middle; assumed: a pinch
TABLE_STIFFNESS: Final = 1e4  # N/m of each corner; assumed: 0.25 mm under a box of 0.5 kg
TABLE_DAMPING: Final = 0.3  # of critical; assumed
DEEPEST: Final = 0.95  # of the texture: friction never vanishes


def least_force(
    held: Object,
    parameters: Parameters | None = None,
    *,
    friction: float = 1.0,
    mass: float = 1.0,
    passive: float = PASSIVE_FRICTION,
    acceleration: float = 0.0,
    texture: float = 1.0,
) -> float:
    """The least grip force (N) that holds an object: m (g + a) / (mu_pad + mu_passive).

    Args:
        held: What is held.
        parameters: Of the fingertip and the scene's material.
        friction: Factor of all frictions.
        mass: Factor of the mass.
        passive: Friction of the passive fingers, of an object whose `friction` is 1.
        acceleration: Of the hand, upwards (m/s2).
        texture: Factor of the pad's friction at this place of the object: 1 where it is first gripped. Along
            the way it lies within 1 - c and 1 + c, c the `texture` of `material`.

    >>> from connectors.sim.objects import named
    >>> round(least_force(named("box")), 2)
    1.87
    """
    mu = (parameters or Parameters()).static_friction * texture + passive
    return held.mass * mass * (GRAVITY + acceleration) / (held.friction * friction * mu)


def material(held: Object, parameters: Parameters) -> Parameters:
    """What the pad touches when it touches an object."""
    return replace(
        parameters,
        static_friction=parameters.static_friction * held.friction,
        kinetic_friction=parameters.kinetic_friction * held.friction,
        texture=min(DEEPEST, parameters.texture * held.texture),
        normal_stiffness=parameters.normal_stiffness * held.stiffness,
    )


def surface(held: Object, parameters: Parameters) -> Scene:
    """What the pad is pressed on."""
    return Scene(curvature=held.curvature, radius=held.radius, parameters=material(held, parameters))


def grip(held: Object, scene: Scene, place: tuple[float, float], passive: float) -> Grip:
    """The constants of a grip.

    Args:
        held: What is held.
        scene: Its `surface`.
        place: Of the pad's middle as seen from the object's middle (m, m).
        passive: Friction of the passive fingers, of an object whose `friction` is 1.
    """
    p, contact = scene.parameters, law(scene)
    rubber = p.shear_stiffness * p.width * p.height  # N/m, of all bristles
    return Grip(
        contact=contact,
        mass=held.mass,
        inertia=held.inertia,
        reach=held.reach,
        half_width=held.width / 2,
        mu=passive * held.friction,
        spring=1 / (1 / p.stiffness + 1 / rubber),  # finger and rubber in series
        damper=contact.damper,
        apart=APART,
        foot=held.foot,
        below=held.length / 2,
        table=-place[1] - held.length / 2,
        table_spring=TABLE_STIFFNESS,
        table_damper=TABLE_DAMPING * math.sqrt(2 * TABLE_STIFFNESS * held.mass),
    )

"""The six objects of the robot tests in "Under Pressure" (2021), as rigid bodies.

The paper names the objects with curvature, roughness and stiffness, but without numbers. Sizes and masses are
those of similar objects of the YCB set (Calli et al., 2015) where there is one, otherwise assumed.
Friction, roughness and stiffness are factors of the fitted values of the simulated scene (`Parameters`),
whose material is smooth plastic. All factors are assumed, in the order of rubber friction in engineering
tables: foam and leather above plastic, plastic above metal, paint and paper.
"""

import math
from dataclasses import dataclass
from typing import Final

from operators.batch import Curvature

SMOOTH: Final = 0.6  # factor of the scene's texture; assumed
ROUGH: Final = 1.2  # assumed


@dataclass(frozen=True, slots=True)
class Object:
    """A rigid body that stands upright, with its curved side towards the fingertip.

    >>> f"{OBJECTS['ball'].inertia:.2g} kg m2"
    '0.00018 kg m2'
    """

    curvature: Curvature
    radius: float  # m, of the curved surface
    width: float  # m, along the pad's x
    length: float  # m, along the pad's y: its height
    mass: float  # kg
    friction: float = 1.0  # factor of static and kinetic friction, also at the passive fingers
    texture: float = SMOOTH  # factor of the depth of the friction's modulation
    stiffness: float = 1.0  # factor of the normal contact stiffness; soft objects spread the pressure

    @property
    def inertia(self) -> float:
        """Moment of inertia about the pad's normal through the centre (kg m2), with uniform density."""
        match self.curvature:
            case "plane":
                square = (self.width**2 + self.length**2) / 12
            case "sphere":
                square = 0.4 * self.radius**2
            case "cylinder_x":
                square = (3 * self.radius**2 + self.width**2) / 12
            case "cylinder_y":
                square = (3 * self.radius**2 + self.length**2) / 12
        return self.mass * square

    @property
    def foot(self) -> float:
        """Half the width of the base (m); 0 for a point or line contact with the table."""
        return 0.0 if self.curvature in {"sphere", "cylinder_x"} else self.width / 2

    @property
    def reach(self) -> float:
        """Largest height above or below the centre at which the fingertip can hold it (m).

        For a ball half the radius (assumed), because the slope beyond it squeezes the ball out.
        """
        return self.radius / 2 if self.curvature == "sphere" else self.length / 2


OBJECTS: Final = {
    # like YCB 004, a box of sugar; its friction is the scene's own: smooth plastic
    "box": Object("plane", math.inf, width=0.089, length=0.175, mass=0.514),
    # like YCB 054, a softball; friction assumed: lacquer
    "ball": Object("sphere", 0.048, width=0.096, length=0.096, mass=0.191, friction=0.8),
    # like YCB 001, a tube of crisps; friction assumed: coated paper
    "cardboard_can": Object("cylinder_y", 0.0375, width=0.075, length=0.25, mass=0.205, friction=0.8),
    # assumed: size, mass (YCB 053, a small football, has 0.123 kg), friction of grained leather, stiffness
    "football_sleeve": Object(
        "sphere", 0.05, 0.1, 0.1, mass=0.15, friction=1.2, texture=ROUGH, stiffness=0.4
    ),
    # a full 0.33 l can, radius 0.033, in 4 mm of foam: all assumed, friction of neoprene
    "foam_sleeve": Object("cylinder_y", 0.037, 0.074, 0.115, mass=0.355, friction=1.1, stiffness=0.25),
    # like YCB 005, a can of soup; friction assumed: ribbed steel
    "metal_can": Object("cylinder_y", 0.033, 0.066, 0.101, mass=0.349, friction=0.9, texture=ROUGH),
}

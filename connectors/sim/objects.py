"""The six objects of the paper's robot tests, as bodies that a grasp can hold.

"Under Pressure" (2021) names them and says of each its curvature, roughness and stiffness (*paper*), and no
number. Sizes and masses are those of like objects in the YCB set (Calli et al., 2015) where it has one, else
assumed. Friction, roughness and stiffness are factors of the values that were fitted for the simulated scene
(`Parameters`), whose material is smooth plastic; all of them are assumed, with the order of rubber on such
surfaces in engineering tables: foam and leather above plastic, plastic above metal, paint and paper.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from connectors.sim.scene import Curvature
from operators.errors import ParameterError

SMOOTH: Final = 0.6  # of the scene's texture; assumed
ROUGH: Final = 1.2  # assumed


@dataclass(frozen=True, slots=True)
class Object:
    """A rigid body with a skin; it stands upright, its curved side towards the fingertip.

    Raises:
        ParameterError: on a value that no body has.

    >>> f"{OBJECTS['ball'].inertia:.2g} kg m2"
    '0.00018 kg m2'
    """

    name: str
    curvature: Curvature
    radius: float  # m, of the curved surface
    width: float  # m, along the pad's x
    length: float  # m, along the pad's y: its height
    mass: float  # kg
    friction: float = 1.0  # static and kinetic, of the scene's; on the passive fingers likewise
    texture: float = 1.0  # depth of the friction's modulation, of the scene's
    stiffness: float = 1.0  # of the contact along the normal, of the scene's: soft ones spread the pressure

    def __post_init__(self) -> None:
        for name in ("radius", "width", "length", "mass", "friction", "stiffness"):
            if not getattr(self, name) > 0:
                raise ParameterError("Object", name, getattr(self, name), "above 0")
        if not self.texture >= 0:
            raise ParameterError("Object", "texture", self.texture, "at least 0")

    @property
    def inertia(self) -> float:
        """Moment about its middle and the pad's normal (kg m2), filled evenly."""
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
        """Half the width that it stands on (m)."""
        return 0.0 if self.curvature in {"sphere", "cylinder_x"} else self.width / 2

    @property
    def reach(self) -> float:
        """How far from its middle, up or down, the fingertip can hold it (m).

        A ball ends sooner than its radius, where its slope squeezes it out: at half of it, assumed.
        """
        return self.radius / 2 if self.curvature == "sphere" else self.length / 2


OBJECTS: Final[Mapping[str, Object]] = MappingProxyType(
    {
        thing.name: thing
        for thing in (
            Object(
                "box",
                "plane",  # paper: planar, smooth, rigid
                radius=math.inf,
                width=0.089,  # YCB 004, a box of sugar
                length=0.175,  # YCB 004
                mass=0.514,  # YCB 004
                friction=1.0,  # smooth plastic: the scene's own material
                texture=SMOOTH,
            ),
            Object(
                "ball",
                "sphere",  # paper: spherical, smooth, rigid
                radius=0.048,  # YCB 054, a softball
                width=0.096,
                length=0.096,
                mass=0.191,  # YCB 054
                friction=0.8,  # assumed: lacquer
                texture=SMOOTH,
            ),
            Object(
                "cardboard_can",
                "cylinder_y",  # paper: cylindrical, smooth, rigid
                radius=0.0375,  # YCB 001, a tube of crisps
                width=0.075,
                length=0.25,  # YCB 001
                mass=0.205,  # YCB 001
                friction=0.8,  # assumed: coated paper
                texture=SMOOTH,
            ),
            Object(
                "football_sleeve",
                "sphere",  # paper: spherical, rough, deformable
                radius=0.05,  # assumed
                width=0.1,
                length=0.1,
                mass=0.15,  # assumed; YCB 053, a small football, has 0.123
                friction=1.2,  # assumed: grained leather
                texture=ROUGH,
                stiffness=0.4,  # assumed
            ),
            Object(
                "foam_sleeve",
                "cylinder_y",  # paper: cylindrical, smooth, deformable
                radius=0.037,  # assumed: a 0.33 l can, radius 0.033, in 4 mm of foam
                width=0.074,
                length=0.115,  # a 0.33 l can
                mass=0.355,  # assumed: the can is full
                friction=1.1,  # assumed: neoprene
                texture=SMOOTH,
                stiffness=0.25,  # assumed
            ),
            Object(
                "metal_can",
                "cylinder_y",  # paper: cylindrical, rough, rigid
                radius=0.033,  # YCB 005, a can of soup
                width=0.066,
                length=0.101,  # YCB 005
                mass=0.349,  # YCB 005
                friction=0.9,  # assumed: ribbed steel
                texture=ROUGH,
            ),
        )
    }
)


def named(name: str) -> Object:
    """The object of that name.

    Raises:
        ParameterError: if there is none.
    """
    if name not in OBJECTS:
        raise ParameterError("named", "name", name, f"one of {', '.join(OBJECTS)}")
    return OBJECTS[name]

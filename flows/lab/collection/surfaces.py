"""What is slid over: a plane, a sphere, or a cylinder that lies down; where the fingertip is on it. Pure."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, get_args

from connectors.sim.relief import drop
from connectors.sim.scene import Curvature, Scene
from flows.lab.collection.arm_path import Pose, beside
from operators.errors import ParameterError

RADIUS: Final = Scene().radius  # m, of curved surfaces, as in the simulated rig
LEAST: Final = 0.001  # m, of a radius
MOST: Final = 1.0  # m; what is flatter is a plane
STEEPEST: Final = math.radians(45)  # of a surface, at the end of a stroke
_FLAT: Final = 1e-6  # rad, of a slope that is none
_BEND: Final = 0.002  # m, from place to place along an arc


@dataclass(frozen=True, slots=True)
class Surface:
    """What is slid over.

    Raises:
        ParameterError: on a curvature that there is not.
    """

    curvature: Curvature
    place: Pose  # where the fingertip just touches it, in the middle, which is its highest point
    radius: float = RADIUS  # m, of a curved one

    def __post_init__(self) -> None:
        if self.curvature not in get_args(Curvature):
            known = ", ".join(get_args(Curvature))
            raise ParameterError("Surface", "curvature", self.curvature, f"one of {known}")
        if not LEAST <= self.radius <= MOST:
            raise ParameterError("Surface", "radius", self.radius, f"from {LEAST} to {MOST} m")

    @property
    def curvatures(self) -> tuple[float, float]:
        """Along the fingertip's x and along its y, 1/m."""
        return Scene(curvature=self.curvature, radius=self.radius).curvatures

    def at(self, x: float, y: float, depth: float = 0.0) -> Pose:
        """Where the fingertip is when it has been pressed in by a depth (m), beside the middle (m).

        >>> round(Surface("sphere", (0.4, 0, 0.1, math.pi, 0, 0), radius=0.05).at(0.03, 0.0)[2], 6)
        0.09
        """
        return beside(self.place, (x, y, drop(self.curvatures, x, y) + depth))

    def bends(self, x: float, y: float) -> list[float]:
        """Where the way to a point beside the middle (m), from opposite it, bends, as parts of x and y.

        The last one is 1, the end; along a straight way it is the only one.

        Raises:
            ParameterError: if it leads too far over the side.

        >>> plane = Surface("plane", (0.4, 0, 0.1, math.pi, 0, 0))
        >>> plane.bends(0.03, 0.0)
        [1.0]
        """
        kx, ky = self.curvatures
        slope, half = math.hypot(kx * x, ky * y), math.hypot(x, y)  # the sine of its angle; m
        if slope > math.sin(STEEPEST):
            least = slope * self.radius / math.sin(STEEPEST)
            must_be = f"{least:.4f} m or more for strokes that reach {half:.4f} m beside its middle"
            raise ParameterError("Surface", "radius", self.radius, must_be)
        if slope < _FLAT:
            return [1.0]
        bends = math.ceil(2 * half / _BEND)
        return [2 * number / bends - 1 for number in range(1, bends + 1)]


class Spot(NamedTuple):
    """A surface that is asked for."""

    curvature: Curvature
    place: Pose | None = None  # see `Surface`; None: where the arm is
    radius: float = RADIUS  # m

    def surface(self, here: Pose) -> Surface:
        """It, for an arm that is here."""
        return Surface(self.curvature, self.place or here, self.radius)


def apart(spots: list[Spot]) -> list[Spot]:
    """Surfaces, each of which is somewhere else.

    Raises:
        ParameterError: if two are at one place.
    """
    places = [spot.place for spot in spots]
    if len(set(places)) < len(places):
        twice = next(place for place in places if places.count(place) > 1)
        where = "where the arm is" if twice is None else list(twice)
        raise ParameterError(
            "collect", "surface", where, "a place for one surface: give each its @X,Y,Z,RX,RY,RZ"
        )
    return spots

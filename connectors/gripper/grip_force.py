"""Scale between the grip force of a Robotiq 3-finger gripper and its force register."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from connectors.gripper.robotiq import FULL
from operators.errors import ParameterError


@dataclass(frozen=True)
class ForceScale:
    """Grip force (N) for each value of the force register, linear between points.

    Robotiq's manual states the ends, 15 N and 60 N, and a nonlinear relation of about 0.175 N per count. The
    default is linear; replace it by points measured with a force gauge.

    Args:
        points: Register value and force (N), both increasing, from register 0 to 255.

    Raises:
        ParameterError: if the points are invalid.

    >>> scale = ForceScale()
    >>> scale.register(15.0), scale.register(37.5), scale.register(60.0), scale.force(127)
    (0, 127, 255, 37.411764705882355)
    """

    points: tuple[tuple[int, float], ...] = ((0, 15.0), (FULL, 60.0))

    def __post_init__(self) -> None:
        registers, forces = [point[0] for point in self.points], [point[1] for point in self.points]
        complete = registers[:1] == [0] and registers[-1:] == [FULL] and forces[0] > 0 and forces[-1] < inf
        if not (complete and _rising(registers) and _rising(forces)):
            must_be = f"registers that increase from 0 to {FULL}, and forces that increase from above 0 N"
            raise ParameterError("ForceScale", "points", self.points, must_be)

    @property
    def weakest(self) -> float:
        """Minimum grip force, N."""
        return self.points[0][1]

    @property
    def strongest(self) -> float:
        """Maximum grip force, N."""
        return self.points[-1][1]

    def register(self, force: float) -> int:
        """Return the greatest register value whose force is at most `force` (N), or 0."""
        registers, forces = zip(*self.points, strict=True)
        return int(np.interp(force, forces, registers) + 1e-6)  # 1e-6: inverts `force` exactly

    def force(self, register: int) -> float:
        """Return the force (N) of a register value."""
        registers, forces = zip(*self.points, strict=True)
        return float(np.interp(register, registers, forces))


def _rising(values: Sequence[float]) -> bool:
    return all(before < after for before, after in pairwise(values))

"""What force a Robotiq 3-finger gripper grips with, and what its force register has to say for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from connectors.gripper.robotiq import FULL
from operators.errors import ParameterError


@dataclass(frozen=True)
class ForceScale:
    """What force (N) the gripper grips with for each value of its force register.

    The manual gives the ends, 15 N and 60 N, and says that the relation between them is not linear, about
    0.175 N per count. The default takes it as linear: an assumption that only a force gauge can replace.
    Give what was measured as points; between them it is linear.

    Args:
        points: Register and force (N), both rising, from register 0 to 255.

    Raises:
        ParameterError: if they are no such points.

    >>> scale = ForceScale()
    >>> scale.register(15.0), scale.register(37.5), scale.register(60.0), scale.force(127)
    (0, 127, 255, 37.411764705882355)
    """

    points: tuple[tuple[int, float], ...] = ((0, 15.0), (FULL, 60.0))

    def __post_init__(self) -> None:
        registers, forces = [point[0] for point in self.points], [point[1] for point in self.points]
        whole = registers[:1] == [0] and registers[-1:] == [FULL] and forces[0] > 0 and forces[-1] < inf
        if not (whole and _rising(registers) and _rising(forces)):
            must_be = f"registers that rise from 0 to {FULL}, and forces that rise from above 0 N"
            raise ParameterError("ForceScale", "points", self.points, must_be)

    @property
    def weakest(self) -> float:
        """The least force (N) that it can grip with."""
        return self.points[0][1]

    @property
    def strongest(self) -> float:
        """The most force (N)."""
        return self.points[-1][1]

    def register(self, force: float) -> int:
        """The largest register value that gives no more than a force (N), or 0 if even that gives more."""
        registers, forces = zip(*self.points, strict=True)
        return int(np.interp(force, forces, registers) + 1e-6)  # 1e-6: a register's own force gives it back

    def force(self, register: int) -> float:
        """The force (N) that a register value gives."""
        registers, forces = zip(*self.points, strict=True)
        return float(np.interp(register, registers, forces))


def _rising(values: Sequence[float]) -> bool:
    return all(before < after for before, after in pairwise(values))

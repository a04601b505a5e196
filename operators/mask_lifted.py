"""What the arm does in the air is no slip."""

from dataclasses import dataclass

import numpy as np

from operators.batch import SLIP, UNKNOWN, Labelled
from operators.errors import ParameterError
from operators.operator import Operator
from operators.rotation import quaternion, turn


@dataclass
class MaskLifted(Operator[Labelled, Labelled]):
    """Take back the slip labels of samples whose fingertip is not where it touches the surface.

    `Label` knows how fast the arm is, not whether anything is touched. The label becomes unknown where the
    TCP is further than `margin` above the plane through `place`, whose pose looks into the surface, along its
    z. On a curved surface that is the plane through its highest point: use a margin that spans it.

    Raises:
        ParameterError: on a margin below 0.
    """

    contact_pose: tuple[float, float, float, float, float, float]  # m and rotation vector: it just touches
    margin: float = 0.002  # m

    def __post_init__(self) -> None:
        if not self.margin >= 0:
            raise ParameterError("MaskLifted", "margin", self.margin, "at least 0 m")

    def process(self, batch: Labelled) -> Labelled:
        """Take labels back."""
        x, y, z, *rotation = self.contact_pose
        u, v, w = turn((0.0, 0.0, 1.0), quaternion((rotation[0], rotation[1], rotation[2])))
        pose = batch.pose  # (n, 6)
        deep = u * (pose[:, 0] - x) + v * (pose[:, 1] - y) + w * (pose[:, 2] - z)  # (n,) m; NaN: unknown
        airborne = (deep < -self.margin) & (batch.label == SLIP)
        if not airborne.any():
            return batch
        label = np.where(airborne, np.int8(UNKNOWN), batch.label).astype(np.int8)
        return Labelled(
            batch.time,
            batch.counts,
            batch.temperature,
            batch.valid,
            batch.velocity,
            batch.pose,
            batch.matched,
            batch.speed,
            label,
            finger=batch.finger,
        )

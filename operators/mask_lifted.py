"""Masking of slip labels without contact."""

from dataclasses import dataclass, replace

import numpy as np

from operators.batch import SLIP, UNKNOWN, Labelled
from operators.checks import check_at_least
from operators.operator import Operator
from operators.rotation import quaternion, rotate


@dataclass
class MaskLifted(Operator[Labelled, Labelled]):
    """Replace slip labels by unknown while the fingertip is lifted off the surface.

    `Label` uses the arm's speed only. This operator masks slip where the TCP is more than `margin` above the
    contact plane. On a curved surface, that is the plane through its highest point: choose a margin that
    covers its height.

    Args:
        contact_pose: TCP pose at first contact, m and rotation vector; z points into the surface.
        margin: Tolerance above the contact plane, m.

    Raises:
        ParameterError: if the margin is below 0.

    >>> samples = Labelled.empty()
    >>> len(MaskLifted((0, 0, 0.1, 3.14, 0, 0)).push(samples))
    0
    """

    contact_pose: tuple[float, float, float, float, float, float]
    margin: float = 0.002

    def __post_init__(self) -> None:
        check_at_least("MaskLifted", "margin", self.margin, 0, "m")

    def process(self, batch: Labelled) -> Labelled:
        """Return the batch with masked labels."""
        x, y, z, *rotation = self.contact_pose
        u, v, w = rotate((0.0, 0.0, 1.0), quaternion((rotation[0], rotation[1], rotation[2])))
        pose = batch.pose  # (n, 6)
        # (n,) m below the contact plane; NaN: unknown
        depth = u * (pose[:, 0] - x) + v * (pose[:, 1] - y) + w * (pose[:, 2] - z)
        lifted = (depth < -self.margin) & (batch.label == SLIP)
        if not lifted.any():
            return batch
        return replace(batch, label=np.where(lifted, np.int8(UNKNOWN), batch.label))

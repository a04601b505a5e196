"""A blow of a mallet on an object that a hand holds."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from operators.batch import Reals
from operators.errors import ParameterError


@dataclass(frozen=True, slots=True)
class Tap:
    """A blow of a mallet: half a sine wave of force.

    On top it goes down through the object's middle. On the side it goes along x (against x where the momentum
    is negative), a quarter of the object's length above its middle, so that it also turns the object.

    Raises:
        ParameterError: if it takes no time.
    """

    instant: float  # s since the run began
    momentum: float  # N s
    place: Literal["top", "side"] = "top"
    seconds: float = 0.01  # contact of a soft mallet; assumed

    def __post_init__(self) -> None:
        if not self.seconds > 0:
            raise ParameterError("Tap", "seconds", self.seconds, "above 0")

    def given(self, t: Reals) -> Reals:
        """Momentum that has been given at instants (k,) (s): (k,) N s."""
        u = np.clip((t - self.instant) / self.seconds, 0.0, 1.0)
        return np.asarray(self.momentum * (1 - np.cos(math.pi * u)) / 2)

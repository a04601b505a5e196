"""Actions in a grasp: the lift of the hand, and taps of a mallet on the object."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from operators.batch import Reals
from operators.errors import ParameterError


@dataclass(frozen=True, slots=True)
class Lift:
    """The hand goes straight up, in a trapezoid of velocity.

    Raises:
        ParameterError: on a height, a speed or an acceleration that is not above 0.

    >>> Lift(2.0, height=0.05, speed=0.1, acceleration=0.5).end
    2.7
    """

    instant: float  # s since the run began
    height: float = 0.05  # m
    speed: float = 0.05  # m/s, at most
    acceleration: float = 0.5  # m/s2

    def __post_init__(self) -> None:
        for name in ("height", "speed", "acceleration"):
            if not getattr(self, name) > 0:
                raise ParameterError("Lift", name, getattr(self, name), "above 0")

    @property
    def _ramp(self) -> float:
        """How long it speeds up, and slows down (s)."""
        return min(self.speed / self.acceleration, math.sqrt(self.height / self.acceleration))

    @property
    def end(self) -> float:
        """When the hand stands still again (s since the run began)."""
        return self.instant + self._ramp + self.height / (self.acceleration * self._ramp)

    def climbed(self, t: Reals) -> Reals:
        """Height of the hand at instants (k,) (s): (k,) m."""
        rising, ramp = np.clip(t - self.instant, 0.0, self.end - self.instant), self._ramp
        left = self.end - self.instant - rising
        cruise = np.clip(rising - ramp, 0.0, self.end - self.instant - 2 * ramp)
        up, down = np.minimum(rising, ramp), np.minimum(left, ramp)
        return np.asarray(self.acceleration * (up**2 / 2 + ramp * cruise + (ramp**2 - down**2) / 2))


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

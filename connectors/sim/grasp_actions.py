"""Actions in a grasp: the lift of the hand, and taps of a mallet on the object."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from operators.batch import Reals
from operators.checks import check_above


@dataclass(frozen=True, slots=True)
class Lift:
    """Vertical motion of the hand with a trapezoidal velocity profile.

    Raises:
        ParameterError: if height, speed or acceleration is not above 0.

    >>> Lift(2.0, height=0.05, speed=0.1, acceleration=0.5).end
    2.7
    """

    instant: float  # s since the run began
    height: float = 0.05  # m
    speed: float = 0.05  # m/s, maximum
    acceleration: float = 0.5  # m/s2

    def __post_init__(self) -> None:
        for name in ("height", "speed", "acceleration"):
            check_above("Lift", name, getattr(self, name), 0)

    @property
    def _ramp(self) -> float:
        """Duration of acceleration and of deceleration (s)."""
        return min(self.speed / self.acceleration, math.sqrt(self.height / self.acceleration))

    @property
    def end(self) -> float:
        """Instant at which the hand stops (s since the run began)."""
        return self.instant + self._ramp + self.height / (self.acceleration * self._ramp)

    def climbed(self, t: Reals) -> Reals:
        """Return the height gained by the hand at instants (k,) (s): (k,) m."""
        rising, ramp = np.clip(t - self.instant, 0.0, self.end - self.instant), self._ramp
        left = self.end - self.instant - rising
        cruise = np.clip(rising - ramp, 0.0, self.end - self.instant - 2 * ramp)
        up, down = np.minimum(rising, ramp), np.minimum(left, ramp)
        return np.asarray(self.acceleration * (up**2 / 2 + ramp * cruise + (ramp**2 - down**2) / 2))


@dataclass(frozen=True, slots=True)
class Tap:
    """A mallet blow: a half sine of force.

    On top it pushes down through the centre of the object. On the side it pushes along x (or -x for a
    negative momentum), a quarter of the length above the centre, so that it also rotates the object.

    Raises:
        ParameterError: if the duration is not above 0.
    """

    instant: float  # s since the run began
    momentum: float  # N s
    place: Literal["top", "side"] = "top"
    seconds: float = 0.01  # duration; assumed: a soft mallet

    def __post_init__(self) -> None:
        check_above("Tap", "seconds", self.seconds, 0)

    def momentum_until(self, t: Reals) -> Reals:
        """Return the momentum transferred until instants (k,) (s): (k,) N s."""
        u = np.clip((t - self.instant) / self.seconds, 0.0, 1.0)
        return np.asarray(self.momentum * (1 - np.cos(math.pi * u)) / 2)

"""Ride of a simulated arm: motion along a polyline with linear ramps of speed. No I/O."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from operators.batch import Reals

_SHORTEST: Final = 1e-12  # m, rad; a leg of length 0 has no direction


@dataclass(frozen=True, slots=True)
class Ride:
    """Motion along a polyline; its speed is linear between instants, and 0 from the last one on."""

    corners: Reals  # (n, 4) m, m, m, rad: x, y, z, yaw
    instants: Reals  # (k,) s
    speeds: Reals  # (k,) m/s; rad/s if the rotation is longer
    acceleration: float  # m/s2, rad/s2, at which it brakes
    begun: float = 0.0  # m or rad, travelled before the first instant

    @classmethod
    def planned(cls, corners: Sequence[Reals], start: float, speed: float, acceleration: float) -> "Ride":
        """Return the ride from the first to the last corner, from rest to rest."""
        ride = cls(np.array(corners), np.array([start, start]), np.zeros(2), acceleration)
        distance = float(ride.distances[-1])
        top = min(speed, math.sqrt(acceleration * distance))
        if not top:
            return ride
        ramp, slowing = top / acceleration, distance / top
        instants = start + np.array([0.0, ramp, slowing, slowing + ramp])
        return replace(ride, instants=instants, speeds=np.array([0.0, top, top, 0.0]))

    @property
    def end(self) -> float:
        """Instant at which it comes to rest, s."""
        return float(self.instants[-1])

    @property
    def distances(self) -> Reals:
        """Distance (n,) from the first corner to each: of the translation, or of the rotation if longer."""
        legs = np.diff(self.corners, axis=0)
        longer = np.maximum(np.linalg.norm(legs[:, :3], axis=1), np.abs(legs[:, 3]))
        return np.concatenate([[0.0], np.cumsum(longer)])

    def travelled(self, times: Reals) -> tuple[Reals, Reals]:
        """Return the distance from the first corner, and the speed, at instants (k,) (s)."""
        t, steps = np.clip(times, self.instants[0], self.end), np.diff(self.instants)
        speed = np.interp(t, self.instants, self.speeds)
        covered = np.concatenate([[self.begun], steps * (self.speeds[1:] + self.speeds[:-1]) / 2]).cumsum()
        part = np.clip(self.instants.searchsorted(t, "right") - 1, 0, len(steps) - 1)
        return covered[part] + (self.speeds[part] + speed) / 2 * (t - self.instants[part]), speed

    def at(self, times: Reals) -> tuple[Reals, Reals]:
        """Return place and velocity (k, 4) at instants (k,) (s)."""
        (distance, speed), corners = self.travelled(times), self.distances
        leg = np.clip(corners.searchsorted(distance, "right") - 1, 0, len(corners) - 2)
        along = np.diff(self.corners, axis=0) / np.maximum(np.diff(corners), _SHORTEST)[:, None]
        place = self.corners[leg] + (distance - corners[leg])[:, None] * along[leg]
        return place, speed[:, None] * along[leg]

    def braked(self, instant: float) -> "Ride":
        """Return the ride that comes to rest from an instant (s) on."""
        [distance], [speed] = self.travelled(np.array([instant]))
        instants = instant + np.array([0.0, speed / self.acceleration])
        return replace(self, instants=instants, speeds=np.array([speed, 0.0]), begun=float(distance))

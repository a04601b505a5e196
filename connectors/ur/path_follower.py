"""Velocity commands that move an arm along a polyline at constant speed. No I/O.

With w the distance (m) travelled, p the arm's position, P(w) the polyline, T its direction and D the delay
from reading the arm's state to the effect of a command::

    v = T(w + s D) s + g (P(w) - p)       s = min(speed, sqrt(2 a (W - w - s' D)))

where W is the length of the polyline and s' the previous s: the arm is steered back onto the polyline, and
comes to rest at its end.
"""

from collections.abc import Sequence
from math import dist, sqrt
from typing import Final

import numpy as np

from connectors.ur.ur_state import Point
from operators.batch import Reals
from operators.errors import ParameterError

DELAY: Final = 0.04  # s, including half the time between commands
GAIN: Final = 8.0  # 1/s


class PathFollower:
    """A polyline, and the distance that an arm has travelled along it.

    Args:
        points: Corners of the polyline, from the arm's position to the end, m.
        speed: Speed along the polyline, m/s.
        acceleration: Deceleration towards the end, m/s2.

    Raises:
        ParameterError: if all points are equal.

    >>> follower = PathFollower([(0, 0, 0), (0.01, 0, 0), (0.1, 0, 0.01)], speed=0.05, acceleration=0.5)
    >>> follower.velocity((0.0, 0.0, 0.0))
    (0.05, 0.0, 0.0)
    """

    def __init__(self, points: Sequence[Point], speed: float, acceleration: float) -> None:
        corners = np.array(points)
        corners = corners[np.append(True, (np.diff(corners, axis=0) != 0).any(axis=1))]
        legs = np.diff(corners, axis=0)
        if not len(legs):
            raise ParameterError("PathFollower", "points", len(points), "two or more that differ")
        lengths = np.linalg.norm(legs, axis=1)
        self._corners, self._directions = corners, legs / lengths[:, None]
        self._distances = np.append(0.0, np.cumsum(lengths))  # m, to each corner
        self._speed, self._acceleration = speed, acceleration
        self._previous = 0.0  # m/s, along the polyline
        self._travelled = 0.0  # m, along the polyline

    def velocity(self, position: Point) -> Point | None:
        """Return the velocity (m/s) for an arm at a position (m); None if it must come to rest."""
        error = self._point(position) - position
        left = self._distances.item(-1) - self._travelled
        braking = sqrt(2 * self._acceleration * max(0.0, left - self._previous * DELAY))  # m/s
        if braking <= min(self._speed, self._acceleration * DELAY):
            return None
        speed = self._previous = min(self._speed, braking)
        onward = self._directions[self._leg(self._travelled + speed * DELAY)]
        x, y, z = (speed * onward + GAIN * error).tolist()
        return x, y, z

    def deviation(self, position: Point) -> float:
        """Return the distance (m) of a position from the polyline or, past its end, from its end point."""
        return dist(position, self._point(position))

    def _point(self, position: Point) -> Reals:
        """Advance to the point of the polyline nearest to the position, never backwards; return it."""
        while True:
            leg = self._leg(self._travelled)
            begin, end = self._distances[leg], self._distances[leg + 1]
            along = begin + (position - self._corners[leg]) @ self._directions[leg]
            self._travelled = max(self._travelled, float(min(along, end)))
            if along < end or end >= self._distances[-1]:
                point: Reals = self._corners[leg] + (self._travelled - begin) * self._directions[leg]
                return point

    def _leg(self, distance: float) -> int:
        """Return the number of the leg at a distance along the polyline."""
        return min(int(self._distances.searchsorted(distance, "right")), len(self._directions)) - 1

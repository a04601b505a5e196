"""Velocity commands that move an arm along a polyline at constant speed. No I/O.

With w the distance (m) travelled, p the arm's position, P(w) the polyline, T its direction and D the delay
from reading the arm's state to the effect of a command::

    v = T(w + s D) s + g (P(w) - p)       s = min(speed, sqrt(2 a (W - w - s' D)))

where W is the length of the polyline and s' the previous s: the arm is steered back onto the polyline, and
comes to rest at its end.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate, pairwise
from math import dist, sqrt
from typing import Final

from connectors.ur.ur_state import Point
from operators.errors import ParameterError

DELAY: Final = 0.04  # s, including half the time between commands
GAIN: Final = 8.0  # 1/s


class PathFollower:
    """A polyline, and the distance that an arm has travelled along it.

    Args:
        points: Corners of the polyline, from the arm's position to the end, m.
        speed: Speed along the polyline, m/s.
        acceleration: Deceleration towards the end, m/s2.

    Attributes:
        travelled: Distance travelled along the polyline, m.

    Raises:
        ParameterError: if all points are equal.

    >>> follower = PathFollower([(0, 0, 0), (0.01, 0, 0), (0.1, 0, 0.01)], speed=0.05, acceleration=0.5)
    >>> follower.velocity((0.0, 0.0, 0.0))
    (0.05, 0.0, 0.0)
    """

    def __init__(self, points: Sequence[Point], speed: float, acceleration: float) -> None:
        self._points = [points[0]] + [b for a, b in pairwise(points) if a != b]
        lengths = (dist(a, b) for a, b in pairwise(self._points))
        self._distances = [0.0, *accumulate(lengths)]  # m, to each point
        if len(self._points) == 1:
            raise ParameterError("PathFollower", "points", len(points), "two or more that differ")
        self._speed, self._acceleration = speed, acceleration
        self._previous = 0.0  # m/s, along the polyline
        self.travelled = 0.0

    def velocity(self, position: Point) -> Point | None:
        """Return the velocity (m/s) for an arm at a position (m); None if it must come to rest."""
        self._advance(position)
        left = self._distances[-1] - self.travelled
        braking = sqrt(2 * self._acceleration * max(0.0, left - self._previous * DELAY))  # m/s
        if braking <= min(self._speed, self._acceleration * DELAY):
            return None
        speed = self._previous = min(self._speed, braking)
        a, b = self._segment(self.travelled + speed * DELAY)
        share, target = speed / dist(a, b), self._point(self.travelled)
        x, y, z = (
            share * (end - begin) + GAIN * (wanted - actual)
            for begin, end, wanted, actual in zip(a, b, target, position, strict=True)
        )
        return x, y, z

    def deviation(self, position: Point) -> float:
        """Return the distance (m) of a position from the polyline or, past its end, from its end point."""
        self._advance(position)
        return dist(position, self._point(self.travelled))

    def _advance(self, position: Point) -> None:
        """Advance to the point of the polyline nearest to the position, never backwards."""
        while True:
            a, b = self._segment(self.travelled)
            begin = self._distances[self._index(self.travelled)]
            length = dist(a, b)
            along = sum((h - p) * (q - p) for h, p, q in zip(position, a, b, strict=True)) / length
            if along < length or begin + length >= self._distances[-1]:
                self.travelled = max(self.travelled, begin + min(along, length))
                return
            self.travelled = max(self.travelled, begin + length)

    def _index(self, distance: float) -> int:
        """Return the index of the segment at a distance along the polyline."""
        return min(bisect_right(self._distances, distance), len(self._distances) - 1) - 1

    def _segment(self, distance: float) -> tuple[Point, Point]:
        index = self._index(distance)
        return self._points[index], self._points[index + 1]

    def _point(self, distance: float) -> Point:
        index = self._index(distance)
        (a, b), (begin, end) = self._segment(distance), self._distances[index : index + 2]
        share = (distance - begin) / (end - begin)
        x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
        return x, y, z

"""Steering an arm along a line of places by velocities, so that it keeps its speed round the bends. Pure.

With w the way (m) that the arm has gone, p where it is, P(w) the line, T its direction and a delay D from a
look at the arm to what it does::

    v = T(w + s D) s + g (P(w) - p)       s = min(speed, sqrt(2 a (W - w - s' D)))

where W is the whole way and s' the s before: the arm is led back onto the line, and comes to rest at its end.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate, pairwise
from math import dist, sqrt
from typing import Final, TypeAlias

from operators.errors import ParameterError

Place: TypeAlias = tuple[float, float, float]  # m

DELAY: Final = 0.04  # s, from a look to what comes of it, half the time that an order is kept up included
GAIN: Final = 8.0  # 1/s


class Course:
    """A line of places, and how far along it an arm is.

    Args:
        places: From where the arm is, to where it is to be.
        speed: Along the line, m/s.
        acceleration: Towards its end, m/s2.

    Raises:
        ParameterError: if it leads nowhere.

    >>> course = Course([(0, 0, 0), (0.01, 0, 0), (0.1, 0, 0.01)], speed=0.05, acceleration=0.5)
    >>> course.steer((0.0, 0.0, 0.0))
    (0.05, 0.0, 0.0)
    """

    def __init__(self, places: Sequence[Place], speed: float, acceleration: float) -> None:
        self._places = [places[0]] + [b for a, b in pairwise(places) if a != b]
        self._ways = [0.0, *accumulate(dist(a, b) for a, b in pairwise(self._places))]  # m, to each place
        if len(self._places) == 1:
            raise ParameterError("Course", "places", len(places), "two or more that differ")
        self._speed, self._acceleration = speed, acceleration
        self._last = 0.0  # m/s, along the line
        self.way = 0.0  # m, that has been gone

    def steer(self, here: Place) -> Place | None:
        """The velocity (m/s) for an arm that is here (m), seen more often than it changes; None: stop."""
        self._proceed(here)
        left = self._ways[-1] - self.way
        braking = sqrt(2 * self._acceleration * max(0.0, left - self._last * DELAY))  # m/s
        if braking <= min(self._speed, self._acceleration * DELAY):
            return None
        speed = self._last = min(self._speed, braking)
        a, b = self._segment(self.way + speed * DELAY)
        share, there = speed / dist(a, b), self._at(self.way)
        x, y, z = (
            share * (end - begin) + GAIN * (on - at)
            for begin, end, on, at in zip(a, b, there, here, strict=True)
        )
        return x, y, z

    def off(self, here: Place) -> float:
        """How far an arm that is here is off the line, m; beyond its end, how far from that."""
        self._proceed(here)
        return dist(here, self._at(self.way))

    def _proceed(self, here: Place) -> None:
        """Go on to the place of the line that is next to here; never back."""
        while True:
            a, b = self._segment(self.way)
            begin = self._ways[self._index(self.way)]
            length = dist(a, b)
            gone = sum((h - p) * (q - p) for h, p, q in zip(here, a, b, strict=True)) / length
            if gone < length or begin + length >= self._ways[-1]:
                self.way = max(self.way, begin + min(gone, length))
                return
            self.way = max(self.way, begin + length)

    def _index(self, way: float) -> int:
        """Of the segment that a way leads to."""
        return min(bisect_right(self._ways, way), len(self._ways) - 1) - 1

    def _segment(self, way: float) -> tuple[Place, Place]:
        index = self._index(way)
        return self._places[index], self._places[index + 1]

    def _at(self, way: float) -> Place:
        index = self._index(way)
        (a, b), (begin, end) = self._segment(way), self._ways[index : index + 2]
        share = (way - begin) / (end - begin)
        x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
        return x, y, z

"""Feeling for a surface: how far an arm has gone towards it, and how hard it is pushed back. Pure."""

from collections import deque
from collections.abc import Sequence
from math import hypot, isnan
from typing import Final

from connectors.ur.course import Place
from connectors.ur.ur_state import State
from operators.errors import ParameterError

MEAN: Final = 4  # states, over which a force is averaged: 32 ms of a CB3 controller
OVERRUN: Final = 0.001  # m, beyond the longest way, that it may take to come to rest


def mean_force(told: Sequence[State]) -> Place | None:
    """The mean of forces (N), which an arm in the air is told though nothing pushes it; None: unknown.

    >>> mean_force([State((0,) * 6, (0,) * 6, (1, 2, 3)), State((0,) * 6, (0,) * 6, (3, 2, 1))])
    (2.0, 2.0, 2.0)
    """
    x, y, z = (sum(each) / len(told) for each in zip(*(state.force for state in told), strict=True))
    return None if isnan(x + y + z) else (x, y, z)


class Probe:
    """Looks at each state of an arm that goes straight on, until it is pushed back.

    Args:
        begin: Where it begins.
        way: The longest that it may go, m.
        force: That it is to be pushed back with, N.
        air: Force that is told though nothing pushes it, N.

    Raises:
        ParameterError: if it leads nowhere, or to no force.

    >>> probe = Probe(State((0,) * 6, (0,) * 6, (0, 0, 0)), way=(0, 0, -0.003), force=2.0, air=(0, 0, 0.5))
    >>> probe.look(State((0, 0, -0.001, 0, 0, 0), (0,) * 6, (0, 0, 1.5)))
    False
    >>> probe.push
    1.0
    """

    def __init__(self, begin: State, way: Place, force: float, air: Place) -> None:
        self.longest = hypot(*way)  # m
        if not self.longest > 0:
            raise ParameterError("Probe", "way", way, "longer than 0")
        if not force > 0:
            raise ParameterError("Probe", "force", force, "above 0 N")
        x, y, z = (each / self.longest for each in way)
        self.direction: Place = x, y, z
        self._begin, self._force, self._air = begin, force, air
        self._pushes = deque[float](maxlen=MEAN)

    @property
    def push(self) -> float:
        """How hard it is pushed back, N: the mean of the newest states."""
        return sum(self._pushes) / max(1, len(self._pushes))

    @property
    def felt(self) -> bool:
        """Whether it is pushed back as it should be."""
        return len(self._pushes) == MEAN and self.push >= self._force

    def look(self, state: State) -> bool:
        """Whether it has to stop: the force is there, or the way has ended."""
        self._pushes.append(self.pushed(state))
        return self.felt or self._gone(state) >= self.longest

    def pushed(self, state: State) -> float:
        """How hard it is pushed back in a state, N."""
        told = zip(self.direction, state.force, self._air, strict=True)
        return -sum(part * (push - air) for part, push, air in told)

    def overruns(self, state: State) -> str:
        """Why it has to be stopped for good: it went on where it should stand; empty: it did not."""
        over = self._gone(state) - self.longest
        if over <= OVERRUN:
            return ""
        return (
            f"it went {1000 * over:.1f} mm beyond the {1000 * self.longest:.1f} mm that it might seek contact"
        )

    def _gone(self, state: State) -> float:
        steps = zip(self.direction, state.pose, self._begin.pose, strict=False)
        return sum(part * (here - begin) for part, here, begin in steps)  # m

"""Search for a surface with an arm: distance moved towards it and contact force. No I/O."""

from collections import deque
from collections.abc import Sequence
from math import hypot, isnan
from typing import Final

from connectors.ur.ur_state import ArmState, Point
from operators.checks import check_above

AVERAGED: Final = 4  # states per mean force: 32 ms at 125 Hz
OVERRUN: Final = 0.001  # m, braking distance allowed beyond the longest distance


def mean_force(states: Sequence[ArmState]) -> Point | None:
    """Return the mean reported force (N); None if the controller reports none."""
    x, y, z = (sum(each) / len(states) for each in zip(*(state.force for state in states), strict=True))
    return None if isnan(x + y + z) else (x, y, z)


class ContactSearch:
    """Contact detection from the states of an arm that moves in a straight line.

    Args:
        start: State at the start.
        path: Longest displacement, m.
        force: Force against the direction of motion that counts as contact, N.
        offset: Force reported without contact, N.

    Attributes:
        longest: Longest distance, m.
        direction: Unit vector of the motion.
        found: True once the mean force of the newest states reaches the contact force.

    Raises:
        ParameterError: if the distance or the force is not above 0.
    """

    def __init__(self, start: ArmState, path: Point, force: float, offset: Point) -> None:
        self.longest, self.found = hypot(*path), False
        check_above("ContactSearch", "path", self.longest, 0, "m")
        check_above("ContactSearch", "force", force, 0, "N")
        self.direction: Point = path[0] / self.longest, path[1] / self.longest, path[2] / self.longest
        self._start, self._force, self._offset = start, force, offset
        self._newest = deque[ArmState](maxlen=AVERAGED)

    @property
    def mean(self) -> float:
        """Mean force (N) of the newest states."""
        return sum(map(self.force, self._newest)) / max(1, len(self._newest))

    def update(self, state: ArmState) -> bool:
        """Add a state, once; return True if the arm must come to rest: contact, or the end of the path."""
        if not (self._newest and self._newest[-1] is state):
            self._newest.append(state)
        self.found = len(self._newest) == AVERAGED and self.mean >= self._force
        return self.found or self._distance(state) >= self.longest

    def force(self, state: ArmState) -> float:
        """Return the force (N) against the direction of motion, minus the offset."""
        axes = zip(self.direction, state.force, self._offset, strict=True)
        return -sum(part * (force - offset) for part, force, offset in axes)

    def overrun(self, state: ArmState) -> str:
        """Return why the arm must be stopped if it moved past the end of the path, else an empty text."""
        over = self._distance(state) - self.longest
        if over <= OVERRUN:
            return ""
        return (
            f"it moved {1000 * over:.1f} mm past the end of its {1000 * self.longest:.1f} mm contact search"
        )

    def _distance(self, state: ArmState) -> float:
        axes = zip(self.direction, state.pose, self._start.pose, strict=False)
        return sum(part * (now - start) for part, now, start in axes)  # m

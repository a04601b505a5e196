"""The hand between a command and the force: when it hears it, how finely it grips, how fast it presses."""

import math
from dataclasses import dataclass
from typing import Final

from connectors.gripper.robotiq import FULL, PACE, SETTLE
from connectors.sim.grasp import Grasp
from operators.batch import Commands, s
from operators.errors import ParameterError

PATHS: Final = {"direct": 0.001, "mqtt": 0.006}  # s from a command to the gripper's master; see `Hand`


@dataclass(frozen=True, slots=True)
class Hand:
    """How a gripper does what it is told.

    A Robotiq 3-finger gripper grips with 15 N at least, ten times what holds these objects in this
    scene. So the hand here is one of its kind for small forces: the same 255 steps, refresh and delay over
    another span. Like that one it locks: asked for less, it stays as it is, until it opens.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    sensing: float = 0.007  # s, conversion's start to event: 3 ms of it convert, 4 read (100 kHz bus)
    path: float = PATHS[
        "direct"
    ]  # s; through a broker on the same host 6 ms (docs/explanations/performance.md, p99)
    refresh: float = PACE  # s, of the gripper's look at its registers: 200 a second (manual)
    settle: float = SETTLE  # s, until a request has its effect (manual: until it shows in the status)
    delay: float = 0.0  # s, added
    rate: float = 10.0  # N/s, at which the force changes; assumed
    span: float = 10.0  # N, of the register's 255 steps; assumed
    locks: bool = False

    def __post_init__(self) -> None:
        for name in ("sensing", "path", "settle", "delay"):
            if not getattr(self, name) >= 0:
                raise ParameterError("Hand", name, getattr(self, name), "at least 0 s")
        for name in ("refresh", "rate", "span"):
            if not getattr(self, name) > 0:
                raise ParameterError("Hand", name, getattr(self, name), "above 0")

    def heard(self, instant: float) -> float:
        """When a command that belongs to a sample of an instant (s) has its effect (s)."""
        told = instant + self.sensing + self.path + self.delay
        return math.ceil(told / self.refresh - 1e-9) * self.refresh + self.settle

    def step(self, force: float) -> float:
        """What it grips with when asked for a force: the highest step not above it (N)."""
        return math.floor(min(max(force, 0.0), self.span) / self.span * FULL + 1e-6) / FULL * self.span


class Grasping:
    """A hand at work on a grasp."""

    def __init__(self, hand: Hand, grasp: Grasp) -> None:
        self._hand, self._grasp = hand, grasp
        self.asked = 0.0  # N, by the newest command
        self._force = 0.0  # N, that it goes to

    def take(self, commands: Commands) -> None:
        """Obey, each command at its time."""
        for time, asked in zip(commands.time.tolist(), commands.force.tolist(), strict=True):
            if math.isnan(asked):
                continue
            self.asked, force = asked, self._hand.step(asked)
            if force == self._force or (self._hand.locks and 0 < force < self._force):
                continue
            self._force = force
            self._grasp.press(force, self._hand.heard(time / s), self._hand.rate)

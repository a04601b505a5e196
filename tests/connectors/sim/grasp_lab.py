"""A grasp on the host's clock, for emulators to serve."""

from collections.abc import Callable
from threading import Lock
from time import time_ns

from connectors.sim.grasp import Grasp, GraspState
from connectors.sim.grasp_source import press
from operators.batch import Commands, Counts, s


class GraspLab:
    """A grasp on the host's clock: what the fingertips on an `I2cBus` feel, and a gripper's mechanism grips.

    It begins when it is built, and may be asked from any thread.

    Args:
        grasp: From its beginning on.
        now: The host's clock, ns since 1970 UTC.
    """

    def __init__(self, grasp: Grasp, now: Callable[[], int] = time_ns) -> None:
        self.now, self.states = now, list[GraspState]()
        self._grasp, self._lock = grasp, Lock()
        self._newest, held = grasp.sense(0.0)
        self.states.append(held)
        self._felt, self._origin = 0, now()

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Raw counts of pressure and temperature of a conversion that starts at `time` (ns), (6,) each.

        The grasp never goes back: less than a millisecond after the newest reading it gives that again.
        """
        del finger
        with self._lock:
            instant = time - self._origin
            if instant - self._felt >= s // 1000:
                self._newest, held = self._grasp.sense(instant / s)
                self.states.append(held)
                self._felt = instant
            newest = self._newest
            return newest.counts[0], newest.temperature[0] * newest.valid[0]

    def command(self, commands: Commands) -> None:
        """Obey commands from their own times on; earlier counts do not change."""
        with self._lock:
            press(self._grasp, commands, self._origin)

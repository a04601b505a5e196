"""A gripper between a command and its force: latency, resolution and speed."""

import math
from dataclasses import dataclass

from connectors.gripper.robotiq import FULL, PACE, SETTLE
from connectors.sim.grasp import Grasp
from operators.batch import Commands, s
from operators.checks import check_above, check_at_least


@dataclass(frozen=True, slots=True)
class GripperModel:
    """Latency, resolution and speed of a gripper.

    A Robotiq 3-Finger Gripper grips with at least 15 N, ten times the force that holds the objects of this
    scene, and cannot reduce its force without opening. The model has its 255 steps, refresh rate and delay,
    but for small forces, and can reduce them.

    Raises:
        ParameterError: on a negative duration, or a period, rate or span that is not above 0.
    """

    sensing: float = 0.007  # s, from conversion to event: 3 ms to convert, 4 ms to read on a 100 kHz bus
    path: float = 0.001  # s, from the command to the gripper
    refresh: float = PACE  # s, period at which the gripper reads its registers (manual: 200 Hz)
    settle: float = SETTLE  # s, from a request to its effect (manual: until the status shows it)
    delay: float = 0.0  # s, added to the latency
    rate: float = 10.0  # N/s, change of the force; assumed
    span: float = 10.0  # N, for the 255 steps of the register; assumed

    def __post_init__(self) -> None:
        for name in ("sensing", "path", "settle", "delay"):
            check_at_least("GripperModel", name, getattr(self, name), 0, "s")
        for name in ("refresh", "rate", "span"):
            check_above("GripperModel", name, getattr(self, name), 0)

    def effect(self, instant: float) -> float:
        """Return the time (s) at which the command for a sample taken at `instant` takes effect."""
        received = instant + self.sensing + self.path + self.delay
        return math.ceil(received / self.refresh - 1e-9) * self.refresh + self.settle

    def quantize(self, force: float) -> float:
        """Return the force (N) of the highest step that does not exceed the commanded one."""
        return math.floor(min(max(force, 0.0), self.span) / self.span * FULL + 1e-6) / FULL * self.span


class Actuator:
    """A gripper model that executes commands on a simulated grasp."""

    def __init__(self, model: GripperModel, grasp: Grasp) -> None:
        self._model, self._grasp = model, grasp
        self.commanded = 0.0  # N, by the newest command
        self._target = 0.0  # N

    def execute(self, commands: Commands) -> None:
        """Execute each command at its time; a command without force changes nothing."""
        for time, force in zip(commands.time.tolist(), commands.force.tolist(), strict=True):
            if math.isnan(force):
                continue
            self.commanded, target = force, self._model.quantize(force)
            if target != self._target:
                self._target = target
                self._grasp.press(target, self._model.effect(time / s), self._model.rate)

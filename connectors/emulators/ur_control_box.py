"""The control box of a UR arm: its clock, safety, modes, registers and program, cycle by cycle. No I/O."""

import logging
import re
from collections.abc import Iterable, Mapping
from enum import IntEnum
from math import inf, nan
from typing import Final, Protocol, cast, runtime_checkable

import numpy as np

from connectors.emulators.ur_drive import Drive
from connectors.emulators.ur_program import Program, Registers
from connectors.emulators.ur_variables import OUTPUTS
from connectors.ur.rtde import Value, Version
from operators.batch import Commands, Reals

log = logging.getLogger("slipflow")

CB3: Final = 3  # major version of the controllers that run at 125 Hz; later ones run at 500 Hz
UNLOCK_AFTER: Final = 5.0  # s from a protective stop until it can be unlocked; dashboard manual
SLIGHT: Final = 1e-5  # m/s, rad/s: a change of the velocity that the arm is not told of


class Arm(Protocol):
    """An arm that the control box drives, such as `connectors.emulators.shared_scene.Lab`."""

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Pose (6,) m, rotation vector, and velocity (6,) m/s, rad/s of the TCP at a host time (ns)."""
        ...

    def command(self, commands: Commands) -> None:
        """Obey from the commands' own times on."""
        ...


@runtime_checkable
class Pressed(Protocol):
    """An arm that knows what pushes it: a `connectors.emulators.pressing_arm.PressingArm`."""

    @property
    def wrench(self) -> Reals:
        """Force (N) and torque (N m) on the tool at the TCP as of the newest motion, (6,), base frame."""
        ...


class RobotMode(IntEnum):
    """What the arm is up to."""

    POWER_OFF = 3
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """What the safety system allows."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    ROBOT_EMERGENCY_STOP = 7


class RuntimeState(IntEnum):
    """What the program is up to."""

    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


SAFETY_BITS: Final = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}


_INTEGER: Final = {"INT32", "UINT32", "UINT64"}
_WIDTH: Final = {"VECTOR3D": 3, "VECTOR6D": 6}


def _unknown(kind: str) -> Value:
    """What the scene does not have, such as joints and currents: NaN, 0 where that cannot be."""
    if kind == "VECTOR6INT32":
        return (0,) * 6
    if kind in _INTEGER:
        return 0
    return (nan,) * _WIDTH[kind] if kind in _WIDTH else nan


class ControlBox:
    """A controller that has just been switched on, its arm ready.

    Variables that the scene does not have are NaN, or 0 where they are integers.

    Attributes:
        version: Of its software.
        rate: Hz of its cycles: 125 of a CB3 (version 3), 500 of an e-Series controller.
        cycles: Since it was switched on; its clock is `cycles / rate`.
        robot_mode, safety_mode, runtime_state: What the arm, the safety system and the program are up to.
        registers: Read and written by clients.
        program: Name of the newest program; empty before the first.
    """

    def __init__(self, arm: Arm, version: Version) -> None:
        self.version, self.rate = version, 125.0 if version.major <= CB3 else 500.0
        self._arm = arm
        self._pressed = arm if isinstance(arm, Pressed) else None
        self._told: Reals = np.zeros(6)  # velocity that the arm was told of last
        self.restart()

    def restart(self) -> None:
        """Switch it off and on: its clock begins anew, its program is gone, its arm comes to rest."""
        self.cycles, self.program, self.registers = 0, "", Registers()
        self.robot_mode, self.safety_mode = RobotMode.RUNNING, SafetyMode.NORMAL
        self.runtime_state = RuntimeState.STOPPED
        self._drive, self._running = Drive(1 / self.rate), cast("Program | None", None)
        self._stopped = 0  # cycle of the newest protective stop
        self._values = {name: _unknown(kind) for name, kind in OUTPUTS.items()}
        self._values.update(speed_scaling=1.0, target_speed_fraction=1.0)

    @property
    def timestamp(self) -> float:
        """The controller's own clock, s since it was switched on."""
        return self.cycles / self.rate

    def cycle(self, time: int) -> None:
        """One cycle, which begins at a host time (ns)."""
        self.cycles += 1
        pose, velocity = self._arm.motion(time)
        if self.runtime_state == RuntimeState.PLAYING and self._running and not self._running.step():
            self.stop_program()
        if self.runtime_state != RuntimeState.PAUSED:
            self._drive.step(pose, velocity)
        if self._drive.lost and self.safety_mode == SafetyMode.NORMAL:
            self.stop_protectively("the arm does not follow its path")
        aim = self._drive.velocity
        if np.abs(aim - self._told).max() > SLIGHT or aim.any() != self._told.any():
            self._told = aim
            self._arm.command(Commands(np.array([time]), np.array([np.nan]), aim[None]))
        self._show(pose, velocity)

    def values(self, names: Iterable[str]) -> list[Value]:
        """Values of output variables as of the newest cycle."""
        return [self._value(name) for name in names]

    def write(self, inputs: Mapping[str, Value]) -> None:
        """Take values of input variables."""
        for name, value in inputs.items():
            kind, _, index = name.rpartition("_register_")
            if kind == "input_int":
                self.registers.input_int[int(index)] = cast("int", value)
            elif kind == "input_double":
                self.registers.input_double[int(index)] = cast("float", value)
        self.registers.fresh |= "input_int_register_0" in inputs

    def run_script(self, script: str) -> None:
        """Run a program that was uploaded, in the place of the one that runs."""
        found = re.match(r"\s*def\s+(\w+)\s*\(", script)
        if found is None or "read_input_integer_reg" not in script:
            log.warning("a script that is not emulated: %.60s", script)
        elif self.robot_mode != RobotMode.RUNNING or self.safety_mode != SafetyMode.NORMAL:
            log.warning("the program %s cannot run in %s", found[1], self.safety_mode.name)
        else:
            self._drive.halt()
            self.program, self.runtime_state = found[1], RuntimeState.PLAYING
            self._running = Program(self.registers, self._drive, 1 / self.rate, self.stop_protectively)

    def stop_program(self) -> None:
        """End the program and bring the arm to rest."""
        self._running, self.runtime_state = None, RuntimeState.STOPPED
        self._drive.stop(inf)

    def play(self) -> bool:
        """Go on with a paused program; False: there is none, or it may not."""
        if self.runtime_state != RuntimeState.PAUSED or self.safety_mode != SafetyMode.NORMAL:
            return False
        self.runtime_state = RuntimeState.PLAYING
        return True

    def pause(self) -> bool:
        """Pause the program, the arm at rest; False: none runs."""
        if self.runtime_state != RuntimeState.PLAYING:
            return False
        self.runtime_state = RuntimeState.PAUSED
        self._drive.hold()
        return True

    def stop_protectively(self, why: str) -> None:
        """Come to rest, the program paused, until it is unlocked."""
        if self.safety_mode == SafetyMode.NORMAL:
            log.warning("protective stop: %s", why)
            self.safety_mode, self._stopped = SafetyMode.PROTECTIVE_STOP, self.cycles
            self.pause()
            self._drive.hold()

    def unlock(self) -> bool:
        """Release a protective stop; False: it is too early."""
        if self.safety_mode == SafetyMode.PROTECTIVE_STOP:
            if self.cycles - self._stopped < UNLOCK_AFTER * self.rate:
                return False
            self.safety_mode = SafetyMode.NORMAL
        return True

    def stop_in_emergency(self) -> None:
        """The button is pressed: the arm comes to rest and loses its power, the program ends."""
        log.warning("emergency stop")
        self.stop_program()
        self._drive.halt()
        self.safety_mode, self.robot_mode = SafetyMode.ROBOT_EMERGENCY_STOP, RobotMode.POWER_OFF

    def release_emergency(self) -> None:
        """The button is pulled out: the arm may be switched on and its brakes released again."""
        if self.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety_mode = SafetyMode.NORMAL

    def switch(self, mode: RobotMode) -> bool:
        """Switch the arm off or on, or release its brakes; False: it may not."""
        if mode != RobotMode.POWER_OFF and self.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP:
            return False
        if mode == RobotMode.RUNNING and self.robot_mode == RobotMode.POWER_OFF:
            return False
        if mode == RobotMode.POWER_OFF:
            self.stop_program()
        if mode != RobotMode.IDLE or self.robot_mode == RobotMode.POWER_OFF:
            self.robot_mode = mode
        return True

    def _show(self, pose: Reals, velocity: Reals) -> None:
        powered, playing = self.robot_mode != RobotMode.POWER_OFF, self.runtime_state == RuntimeState.PLAYING
        self._values.update(
            timestamp=self.timestamp,
            actual_TCP_pose=tuple(pose.tolist()),
            actual_TCP_speed=tuple(velocity.tolist()),
            target_TCP_speed=tuple(self._drive.velocity.tolist()),
            robot_mode=self.robot_mode,
            safety_mode=self.safety_mode,
            runtime_state=self.runtime_state,
            robot_status_bits=powered + 2 * playing,
            safety_status_bits=SAFETY_BITS[self.safety_mode],
        )
        if self._pressed:
            self._values["actual_TCP_force"] = tuple(self._pressed.wrench.tolist())

    def _value(self, name: str) -> Value:
        kind, _, index = name.rpartition("_register_")
        if kind == "output_int":
            return self.registers.output_int[int(index)]
        if kind == "output_double":
            return self.registers.output_double[int(index)]
        return self._values[name]

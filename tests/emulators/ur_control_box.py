"""Control box of an emulated UR arm: clock, safety, modes, variables, program and dashboard. No I/O.

Sources: Universal Robots, "Real-Time Data Exchange (RTDE) Guide": the variables of version 3.4, and the later
ones that ur-rtde requests; "Dashboard Server e-Series, port 29999" and "..., CB-Series".
"""

import logging
import re
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from math import inf, nan
from types import MappingProxyType
from typing import Final, Protocol, cast

import numpy as np

from connectors.ur.rtde import Version
from operators.batch import Reals
from tests.emulators.rtde_recipe import Value
from tests.emulators.ur_program import REGISTERS, Drive, Program, Registers

log = logging.getLogger("slipflow")

CB3: Final = 3  # major version of the controllers that run at 125 Hz; later ones run at 500 Hz
VELOCITY_TOLERANCE: Final = 1e-5  # m/s, rad/s; smaller changes are not commanded


class RobotMode(IntEnum):
    """Mode of the arm (RTDE guide, robot_mode)."""

    POWER_OFF = 3
    RUNNING = 7


class SafetyMode(IntEnum):
    """State of the safety system (RTDE guide, safety_mode)."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    ROBOT_EMERGENCY_STOP = 7


class RuntimeState(IntEnum):
    """State of the program (RTDE guide, runtime_state)."""

    STOPPED = 1
    PLAYING = 2


SAFETY_BITS: Final = {  # RTDE guide, safety_status_bits
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}

_BY_TYPE: Final = {
    "DOUBLE": "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum"
    " actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0"
    " standard_analog_input1 standard_analog_output0 standard_analog_output1 payload",
    "VECTOR3D": "actual_tool_accelerometer payload_cog",
    "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current"
    " actual_current_as_torque joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force"
    " target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage ft_raw_wrench payload_inertia",
    "VECTOR6INT32": "joint_mode",
    "INT32": "robot_mode safety_mode",
    "UINT32": "runtime_state robot_status_bits safety_status_bits",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
}

OUTPUTS: Final[Mapping[str, str]] = MappingProxyType(
    {name: kind for kind, names in _BY_TYPE.items() for name in names.split()}
    | {f"output_int_register_{i}": "INT32" for i in range(REGISTERS)}
    | {f"output_double_register_{i}": "DOUBLE" for i in range(REGISTERS)}
)
INPUTS: Final[Mapping[str, str]] = MappingProxyType(
    {f"input_int_register_{i}": "INT32" for i in range(REGISTERS)}
    | {f"input_double_register_{i}": "DOUBLE" for i in range(REGISTERS)}
    | {"external_force_torque": "VECTOR6D"}
)
_INTEGER: Final = {"INT32", "UINT32", "UINT64"}
_WIDTH: Final = {"VECTOR3D": 3, "VECTOR6D": 6}


def _placeholder(kind: str) -> Value:
    """Return the value of a variable that is not simulated, such as a current: 0 for integers, else NaN."""
    if kind == "VECTOR6INT32":
        return (0,) * 6
    if kind in _INTEGER:
        return 0
    return (nan,) * _WIDTH[kind] if kind in _WIDTH else nan


class Arm(Protocol):
    """An arm that follows velocity commands, such as a `FreeArm`."""

    @property
    def wrench(self) -> Reals:
        """Force (N) and torque (N m) on the tool at the latest motion, (6,); NaN if it is not measured."""
        ...

    def motion(self, time: int) -> tuple[Reals, Reals]:
        """Return pose (6,) m, rad and velocity (6,) m/s, rad/s of the TCP at a host time (ns)."""
        ...

    def command(self, time: int, velocity: Reals) -> None:
        """Follow a velocity (6,) m/s, rad/s from a host time (ns) on."""
        ...


class ControlBox:
    """A control box after power-up, with its arm ready.

    Integer variables that are not simulated are 0, all others NaN.

    Attributes:
        version: Version of the software.
        rate: Cycles per second: 125 for CB3 (version 3), 500 for e-Series.
        cycles: Cycles since power-up; the clock of the controller is `cycles / rate`.
        robot_mode, safety_mode, runtime_state: State of the arm, the safety system and the program.
        registers: Registers that clients read and write.
        program: Name of the latest program; empty before the first.
        drive: Motion of the arm.
    """

    def __init__(self, arm: Arm, version: Version) -> None:
        self.version, self.rate = version, 125.0 if version.major <= CB3 else 500.0
        self._arm = arm
        self._commanded: Reals = np.zeros(6)  # velocity
        self.power_up()

    def power_up(self) -> None:
        """Reset the clock, the registers and the program, and bring the arm to rest."""
        self.cycles, self.program, self.registers = 0, "", Registers()
        self.robot_mode, self.safety_mode = RobotMode.RUNNING, SafetyMode.NORMAL
        self.runtime_state = RuntimeState.STOPPED
        self.drive, self._running = Drive(1 / self.rate), cast("Program | None", None)
        self._values = {name: _placeholder(kind) for name, kind in OUTPUTS.items()}
        self._values.update(speed_scaling=1.0, target_speed_fraction=1.0)

    @property
    def timestamp(self) -> float:
        """Clock of the controller (s since power-up)."""
        return self.cycles / self.rate

    def cycle(self, time: int) -> None:
        """Run one cycle that begins at a host time (ns)."""
        self.cycles += 1
        pose, velocity = self._arm.motion(time)
        if self.runtime_state == RuntimeState.PLAYING and self._running and not self._running.step():
            self.stop_program()
        self.drive.step(pose, velocity)
        target = self.drive.velocity
        change = np.abs(target - self._commanded).max()
        if change > VELOCITY_TOLERANCE or target.any() != self._commanded.any():
            self._commanded = target
            self._arm.command(time, target)
        self._update(pose, velocity)

    def values(self, names: Iterable[str]) -> list[Value]:
        """Return the values of output variables at the latest cycle."""
        return [self._value(name) for name in names]

    def write(self, inputs: Mapping[str, Value]) -> None:
        """Set input variables."""
        for name, value in inputs.items():
            kind, _, index = name.rpartition("_register_")
            if kind == "input_int":
                self.registers.input_int[int(index)] = cast("int", value)
            elif kind == "input_double":
                self.registers.input_double[int(index)] = cast("float", value)
        self.registers.command_written |= "input_int_register_0" in inputs

    def run_script(self, script: str) -> None:
        """Replace the current program by an uploaded one and run it; ignore other scripts."""
        found = re.match(r"\s*def\s+(\w+)\s*\(", script)
        if found is None or "read_input_integer_reg" not in script:
            log.warning("ignoring an unsupported script: %.60s", script)
        elif self.safety_mode != SafetyMode.NORMAL:
            log.warning("program %s cannot run in safety mode %s", found[1], self.safety_mode.name)
        else:
            self.drive.halt()
            self.program, self.runtime_state = found[1], RuntimeState.PLAYING
            self._running = Program(self.registers, self.drive, 1 / self.rate, self.stop_protectively)

    def stop_program(self) -> None:
        """End the program and bring the arm to rest."""
        self._running, self.runtime_state = None, RuntimeState.STOPPED
        self.drive.stop(inf)

    def stop_protectively(self, reason: str) -> None:
        """Stop the arm and its program; no program runs until `unlock`."""
        if self.safety_mode == SafetyMode.NORMAL:
            log.warning("protective stop: %s", reason)
            self.safety_mode = SafetyMode.PROTECTIVE_STOP
            self.stop_program()
            self.drive.halt()

    def unlock(self) -> None:
        """Release a protective stop; the emulator needs no waiting time before."""
        if self.safety_mode == SafetyMode.PROTECTIVE_STOP:
            self.safety_mode = SafetyMode.NORMAL

    def _update(self, pose: Reals, velocity: Reals) -> None:
        powered, playing = self.robot_mode != RobotMode.POWER_OFF, self.runtime_state == RuntimeState.PLAYING
        self._values.update(
            timestamp=self.timestamp,
            actual_TCP_pose=tuple(pose.tolist()),
            actual_TCP_speed=tuple(velocity.tolist()),
            target_TCP_speed=tuple(self.drive.velocity.tolist()),
            robot_mode=self.robot_mode,
            safety_mode=self.safety_mode,
            runtime_state=self.runtime_state,
            robot_status_bits=powered + 2 * playing,
            safety_status_bits=SAFETY_BITS[self.safety_mode],
            actual_TCP_force=tuple(self._arm.wrench.tolist()),
        )

    def _value(self, name: str) -> Value:
        kind, _, index = name.rpartition("_register_")
        if kind == "output_int":
            return self.registers.output_int[int(index)]
        if kind == "output_double":
            return self.registers.output_double[int(index)]
        return self._values[name]


# dashboard: one reply line per request line

GREETING: Final = "Connected: Universal Robots Dashboard Server"
FAREWELL: Final = "Disconnected"
SERIAL_NUMBER: Final = "20195501234"  # ur-rtde requires one


def answer(box: ControlBox, line: str) -> str:
    """Execute a request line on a control box and return the reply.

    Unknown requests are answered as a real server does: ``could not understand: REQUEST``.
    """
    request = line.strip()
    execute = _COMMANDS.get(request.lower())
    return execute(box) if execute else f"could not understand: {request}"


def _stop(box: ControlBox) -> str:
    if box.runtime_state == RuntimeState.STOPPED:
        return "Failed to execute: stop"
    box.stop_program()
    return "Stopped"


def _unlock(box: ControlBox) -> str:
    box.unlock()
    return "Protective stop releasing"


def _state(box: ControlBox) -> str:
    return f"{box.runtime_state.name} {box.program or '<unnamed>'}"


_COMMANDS: Final[Mapping[str, Callable[[ControlBox], str]]] = MappingProxyType(
    {
        "polyscopeversion": lambda box: f"URSoftware {box.version} (Jan 01 2022)",
        "get serial number": lambda _: SERIAL_NUMBER,
        "is in remote control": lambda _: "true",
        "running": lambda box: f"Program running: {str(box.runtime_state == RuntimeState.PLAYING).lower()}",
        "programstate": _state,
        "stop": _stop,
        "robotmode": lambda box: f"Robotmode: {box.robot_mode.name}",
        "safetystatus": lambda box: f"Safetystatus: {box.safety_mode.name}",
        "unlock protective stop": _unlock,
        "quit": lambda _: FAREWELL,
    }
)

"""Control box of an emulated UR arm: clock, safety, modes, variables, program and dashboard. No I/O.

Sources: Universal Robots, "Real-Time Data Exchange (RTDE) Guide"; "Dashboard Server e-Series,
port 29999" and "..., CB-Series".
"""

import logging
import re
from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Final, TypeAlias, cast

from operators.batch import Reals
from tests.emulators.ur_program import REGISTERS, Drive, Program, Registers

log = logging.getLogger("slipflow")

Value: TypeAlias = float | tuple[float, ...]  # includes integers

CB3: Final = 3  # major version of the controllers that run at 125 Hz; later ones run at 500 Hz


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


OUTPUTS: Final[Mapping[str, str]] = MappingProxyType(  # that UrMotion and RTDEControlInterface request
    {
        **dict.fromkeys(("timestamp", "target_speed_fraction"), "DOUBLE"),
        **dict.fromkeys(("actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force"), "VECTOR6D"),
        **dict.fromkeys(("robot_mode", "safety_mode"), "INT32"),
        **dict.fromkeys(("runtime_state", "robot_status_bits", "safety_status_bits"), "UINT32"),
        **{f"output_int_register_{i}": "INT32" for i in range(3)},
        **{f"output_double_register_{i}": "DOUBLE" for i in range(REGISTERS)},
    }
)
INPUTS: Final[Mapping[str, str]] = MappingProxyType(
    {f"input_int_register_{i}": "INT32" for i in range(REGISTERS)}
    | {f"input_double_register_{i}": "DOUBLE" for i in range(REGISTERS)}
    | {"external_force_torque": "VECTOR6D"}
)


class ControlBox:
    """A control box after power-up, with its arm ready."""

    slider = 1.0  # of speed, on the teach pendant

    def __init__(self, pose: Reals, version: tuple[int, ...]) -> None:
        self.version, self.rate = version, 125.0 if version[0] <= CB3 else 500.0
        self.drive = Drive(pose, 1 / self.rate)
        self.power_up()

    def power_up(self) -> None:
        """Reset the clock, the registers and the program; the arm stays as it is."""
        self.cycles = 0  # since power-up
        self.registers = Registers()
        self.robot_mode, self.safety_mode = RobotMode.RUNNING, SafetyMode.NORMAL
        self.runtime_state, self._program = RuntimeState.STOPPED, cast("Program | None", None)

    @property
    def timestamp(self) -> float:
        """Clock of the controller (s since power-up)."""
        return self.cycles / self.rate

    def cycle(self) -> None:
        """Run one cycle."""
        self.cycles += 1
        self.drive.step()
        if self._program and not self._program.step():
            self.stop_program()

    def values(self) -> dict[str, Value]:
        """Return the output variables."""
        powered, playing = self.robot_mode != RobotMode.POWER_OFF, self.runtime_state == RuntimeState.PLAYING
        return {
            **dict.fromkeys(OUTPUTS, 0.0),
            "timestamp": self.timestamp,
            "target_speed_fraction": self.slider,
            "actual_TCP_pose": tuple(self.drive.pose.tolist()),
            "actual_TCP_speed": tuple(self.drive.velocity.tolist()),
            "actual_TCP_force": (0.0, 0.0, self.drive.push, 99.0, 0.0, 0.0),  # the torques are no force
            "robot_mode": self.robot_mode,
            "safety_mode": self.safety_mode,
            "runtime_state": self.runtime_state,
            "robot_status_bits": powered + 2 * playing,
            "safety_status_bits": int(self.safety_mode == SafetyMode.NORMAL),
            **{f"output_int_register_{i}": self.registers.output_int[i] for i in range(3)},
        }

    def write(self, inputs: Mapping[str, float]) -> None:
        """Set input variables."""
        for name, value in inputs.items():
            kind, _, index = name.rpartition("_register_")
            if kind == "input_int":
                self.registers.input_int[int(index)] = int(value)
            elif kind == "input_double":
                self.registers.input_double[int(index)] = value
        self.registers.command_written |= "input_int_register_0" in inputs

    def run_script(self, script: str) -> None:
        """Replace the current program by an uploaded one and run it; ignore other scripts."""
        if not re.match(r"\s*def\s+(\w+)\s*\(", script) or "read_input_integer_reg" not in script:
            log.warning("ignoring an unsupported script: %.60s", script)
        elif self.safety_mode == SafetyMode.NORMAL:
            self.drive.halt()
            self._program = Program(self.registers, self.drive, 1 / self.rate)
            self.runtime_state = RuntimeState.PLAYING

    def stop_program(self) -> None:
        """End the program and bring the arm to rest."""
        self._program, self.runtime_state = None, RuntimeState.STOPPED
        self.drive.stop()

    def stop_for(self, mode: SafetyMode) -> None:
        """Stop the arm and its program for safety; in an emergency the arm loses its power."""
        self.stop_program()
        self.drive.halt()
        self.safety_mode = mode
        if mode == SafetyMode.ROBOT_EMERGENCY_STOP:
            self.robot_mode = RobotMode.POWER_OFF


# dashboard: one reply line per request line

GREETING: Final = "Connected: Universal Robots Dashboard Server"


def answer(box: ControlBox, line: str) -> str:
    """Execute a request line on a control box and return the reply."""
    request, playing = line.strip().lower(), box.runtime_state == RuntimeState.PLAYING
    if request == "stop":
        box.stop_program()
        return "Stopped" if playing else "Failed to execute: stop"
    replies = {
        "polyscopeversion": f"URSoftware {'.'.join(map(str, box.version))} (Jan 01 2022)",
        "get serial number": "20195501234",  # ur-rtde requires one
        "is in remote control": "true",
        "running": f"Program running: {str(playing).lower()}",
    }
    return replies.get(request, f"could not understand: {request}")

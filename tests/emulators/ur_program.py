"""Control program that ur-rtde uploads to a UR controller, and the arm's motion under its commands.

The program executes commands from the input registers. The command is a number in input_int_register_0 (0 for
none), its parameters are in the other registers. The program sets output_int_register_0 to 1 when it is ready
for a command, and to 2 from the end of a command until the client resets the command to 0. A speed command
takes effect at once and lasts until it is stopped.

Source: rtde_control.script of ur-rtde 1.6.5, which runs on the controller. Only the commands of `UrArm` are
emulated; all others end the program, like an error in a script.

With D the remaining distance (m, or the remaining angle in rad if that is larger), the speed of a line is

    speed = min(v, sqrt(a D), D / (4 cycles), previous speed + a * cycle)

so that it converges for every acceleration of the arm.
"""

import logging
from dataclasses import dataclass, field
from enum import IntEnum
from math import inf, sqrt
from typing import Final, Literal, TypeAlias

import numpy as np

from operators.batch import Reals
from operators.rotation import compose, rotation_difference

log = logging.getLogger("slipflow")

Task: TypeAlias = Literal["none", "line", "speed", "stop"]

STIFFNESS: Final = 1000.0  # N/m, of the surface at height 0
_POSE_TOLERANCE: Final = 5e-5  # m, rad; a UR10 has a repeatability of 1e-4 m
_FASTEST: Final = 1.0  # m/s2 and rad/s2
REGISTERS: Final = 48  # per type and direction
READY: Final = 1
DONE: Final = 2


class Drive:
    """Arm that executes motion tasks; a new task replaces the current one without a step in velocity."""

    def __init__(self, pose: Reals, period: float) -> None:
        self.pose = pose.astype(np.float64)  # (6,) m and rotation vector of the TCP, base frame
        self.velocity = np.zeros(6)  # m/s and rad/s
        self.task: Task = "none"
        self._period = period  # s, of a cycle
        self._target = np.zeros(6)  # pose of a line task, else velocity
        self._speed = self._acceleration = 0.0

    @property
    def push(self) -> float:
        """Force (N) of the surface at height 0 on the arm."""
        return STIFFNESS * max(0.0, -self.pose.item(2))

    def line(self, pose: Reals, speed: float, acceleration: float) -> None:
        """Move straight to a pose (6,) m and rotation vector, at a speed (m/s) and acceleration (m/s2)."""
        self._begin("line", pose, speed, acceleration)

    def speed(self, velocity: Reals, acceleration: float) -> None:
        """Accelerate (m/s2 and rad/s2) to a velocity (6,) m/s and rad/s and keep it."""
        self._begin("speed", velocity, 0.0, acceleration)

    def stop(self, deceleration: float = inf) -> None:
        """Decelerate to rest (m/s2 and rad/s2)."""
        self._begin("stop", np.zeros(6), 0.0, deceleration)

    def halt(self) -> None:
        """Abort the task and stop at once."""
        self.task, self.velocity = "none", np.zeros(6)

    def step(self) -> None:
        """Run one cycle."""
        turned = compose(tuple(self.pose[3:].tolist()), tuple((self.velocity[3:] * self._period).tolist()))
        self.pose = np.array([*(self.pose[:3] + self.velocity[:3] * self._period), *turned])
        if self.task == "line":
            self._follow()
        elif self.task != "none":
            self._approach()
        if self.task == "stop" and not self.velocity.any():
            self.task = "none"

    def _begin(self, task: Task, target: Reals, speed: float, acceleration: float) -> None:
        self.task, self._target, self._speed = task, target.copy(), speed
        self._acceleration = min(acceleration, _FASTEST)

    def _follow(self) -> None:
        turn = rotation_difference(tuple(self.pose[3:].tolist()), tuple(self._target[3:].tolist()))
        remaining = np.concatenate((self._target[:3] - self.pose[:3], turn))  # (6,)
        distance = float(max(np.linalg.norm(remaining[:3]), np.linalg.norm(remaining[3:])))
        if distance < _POSE_TOLERANCE:
            self.halt()
            return
        previous = max(0.0, float(self.velocity @ remaining) / float(remaining @ remaining)) * distance
        braking = sqrt(self._acceleration * distance)
        settling = distance / (4 * self._period)
        speed = min(self._speed, braking, settling, previous + self._acceleration * self._period)
        self.velocity = remaining * (speed / distance)

    def _approach(self) -> None:
        self.velocity = self.velocity.copy()
        for part in (slice(0, 3), slice(3, 6)):  # separate ramps for translation and rotation
            change = self._target[part] - self.velocity[part]
            fraction = self._acceleration * self._period / max(float(np.linalg.norm(change)), 1e-12)
            self.velocity[part] += change * min(1.0, fraction)


class Command(IntEnum):
    """Command in input_int_register_0, with its parameters."""

    NONE = 0
    MOVE_LINE = 3  # doubles 0..5 pose, 6 speed, 7 acceleration; asynchronous
    SPEED = 10  # doubles 0..5 velocity, 6 acceleration
    STOP_SPEED = 15  # double 0 deceleration
    STOP_LINE = 33  # double 0 deceleration; asynchronous
    SET_WATCHDOG = 35  # double 0 minimum rate (Hz) of commands
    END = 255


@dataclass
class Registers:
    """General-purpose registers."""

    input_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    input_double: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    output_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    command_written: bool = False  # True if a command was written since the last cycle


class Program:
    """The running program; `period` is the duration of a cycle (s)."""

    def __init__(self, registers: Registers, drive: Drive, period: float) -> None:
        self._registers, self._drive, self._period = registers, drive, period
        self._waiting = False  # True until the arm stands
        self._executed = False  # True once the command in the register was executed
        self._silence, self._watchdog = 0.0, inf  # s since the last command, and the limit
        registers.output_int[0] = READY

    def step(self) -> bool:
        """Run one cycle; return False when the program has ended."""
        registers, drive = self._registers, self._drive
        self._silence = 0.0 if registers.command_written else self._silence + self._period
        registers.command_written = False
        if self._silence > self._watchdog:
            log.warning("watchdog: no command for %.3f s, the program ends", self._silence)
            return False
        if self._waiting:
            if drive.task == "none":
                self._waiting = False
                registers.output_int[0] = DONE
            return True
        command = registers.input_int[0]
        if command == Command.NONE:
            self._executed = False
            registers.output_int[0] = READY
        elif command == Command.SPEED:
            drive.speed(np.array(registers.input_double[:6]), registers.input_double[6])
            registers.output_int[0] = READY
        elif not self._executed:
            self._executed = True
            return self._execute(command)
        return True

    def _execute(self, command: int) -> bool:
        registers, drive = self._registers, self._drive
        first = registers.input_double[0]
        match command:
            case Command.MOVE_LINE:
                speed, acceleration = registers.input_double[6:8]
                drive.line(np.array(registers.input_double[:6]), speed, acceleration)
            case Command.STOP_SPEED:
                drive.stop(first)
                self._waiting = True
                return True
            case Command.STOP_LINE:
                drive.stop(first)
            case Command.SET_WATCHDOG:
                self._watchdog = 1 / first if first > 0 else inf
            case _:
                if command != Command.END:
                    log.warning("command %d is not emulated: the program ends", command)
                return False
        registers.output_int[0] = DONE
        return True

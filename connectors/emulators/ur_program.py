"""The program that ur-rtde uploads to a UR controller: it obeys commands in the input registers.

A command is a number in input_int_register_0, its values stand in the other registers; 0 is none. The program
answers in output_int_register_0: 1 it is ready for one, 2 it is done with one, until that is taken back. A
speed is taken at once and goes on until it is stopped.

Source: rtde_control.script of ur-rtde 1.6.5, which runs on the controller. Commands that neither a collection
nor a safe stop needs are not emulated: they end the program, as an error in a script does.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np

from connectors.emulators.ur_drive import Drive
from connectors.emulators.ur_variables import REGISTERS
from operators.batch import Reals

log = logging.getLogger("slipflow")

READY: Final = 1
DONE: Final = 2


class Command(IntEnum):
    """What input_int_register_0 asks for."""

    NONE = 0
    MOVE_LINE = 3  # doubles 0..5 pose, 6 speed, 7 acceleration; int 1: 1 asynchronous
    ZERO_FORCE_SENSOR = 8  # the scene's force needs no zero
    SPEED = 10  # doubles 0..5 velocity, 6 acceleration
    STOP_SPEED = 15  # double 0 deceleration
    SET_PAYLOAD = 17  # the scene's arm carries any
    STOP_PROTECTIVELY = 31
    STOP_LINE = 33  # double 0 deceleration; int 1: 1 asynchronous
    STOP_JOINTS = 34  # the same
    SET_WATCHDOG = 35  # double 0 least rate (Hz) at which the command must be written
    IS_STEADY = 47  # answers in output_int_register_1
    END = 255


@dataclass
class Registers:
    """General purpose registers; inputs keep what was written last."""

    input_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    input_double: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    output_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    output_double: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    fresh: bool = False  # the command was written since the last cycle


class Program:
    """The program while it runs.

    Args:
        registers: Of the controller.
        drive: Of its arm.
        period: Of the cycles, s.
        protect: What a protective stop on command does.
    """

    def __init__(
        self, registers: Registers, drive: Drive, period: float, protect: Callable[[str], None]
    ) -> None:
        self._registers, self._drive, self._period, self._protect = registers, drive, period, protect
        self._busy = self._obeyed = self._moving = False  # with a command; taken back yet; asynchronously
        self._operations = self._writes = 0  # asynchronous ones
        self._silence, self._longest = 0.0, np.inf  # s without a command, and how much of it is too much
        self._progress(running=False)
        registers.output_int[0] = READY

    def step(self) -> bool:
        """One cycle; False when the program has ended."""
        registers, drive = self._registers, self._drive
        self._silence = 0.0 if registers.fresh else self._silence + self._period
        registers.fresh = False
        if self._silence > self._longest:
            log.warning("the watchdog ends the program: no command for %.3f s", self._silence)
            return False
        if self._moving and drive.task == "none":
            self._moving = False
            self._progress(running=False)
        if self._busy:
            if drive.task == "none":
                self._busy = False
                registers.output_int[0] = DONE
            return True
        command = registers.input_int[0]
        if command == Command.NONE:
            self._obeyed = False
            registers.output_int[0] = READY
        elif command == Command.SPEED:
            drive.speed(self._vector(), registers.input_double[6])
            registers.output_int[0] = READY
        elif not self._obeyed:
            self._obeyed = True
            return self._obey(command)
        return True

    def _obey(self, command: int) -> bool:
        registers, drive = self._registers, self._drive
        first, asynchronous = registers.input_double[0], registers.input_int[1] == 1
        match command:
            case Command.MOVE_LINE:
                drive.line(self._vector(), registers.input_double[6], registers.input_double[7])
                self._begin(asynchronous=asynchronous)
            case Command.STOP_SPEED:
                drive.stop(first)
                self._begin(asynchronous=False)
            case Command.STOP_LINE | Command.STOP_JOINTS:
                drive.stop(first)
                self._begin(asynchronous=asynchronous)
            case Command.STOP_PROTECTIVELY:
                self._protect("on command")
            case Command.SET_WATCHDOG:
                self._longest = 1 / first if first > 0 else np.inf
            case Command.IS_STEADY:
                registers.output_int[1] = int(drive.task == "none")
            case Command.ZERO_FORCE_SENSOR | Command.SET_PAYLOAD:
                pass
            case Command.END:
                return False
            case _:
                log.warning("command %d is not emulated: the program ends", command)
                return False
        if not self._busy:
            registers.output_int[0] = DONE
        return True

    def _vector(self) -> Reals:
        return np.array(self._registers.input_double[:6])

    def _begin(self, *, asynchronous: bool) -> None:
        if self._moving or asynchronous:
            self._progress(running=asynchronous)
        self._moving, self._busy = asynchronous, not asynchronous

    def _progress(self, *, running: bool) -> None:
        """Tell in output_int_register_2 that an asynchronous operation began or ended."""
        self._writes = (self._writes + 1) % 128
        self._operations = (self._operations + running) % 128
        self._registers.output_int[2] = (self._operations << 24) + (self._writes << 16) + (running << 15)

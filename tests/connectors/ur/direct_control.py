"""Control of an emulated arm without ur-rtde and its process, for tests in virtual time."""

import asyncio
from collections.abc import Callable

import numpy as np

from connectors.ur.control_process import STOP_DECELERATION, Command, Move, MoveTo, Signal
from tests.emulators.ur_control_box import ControlBox, SafetyMode


class DirectControl:
    """Stand-in for `ControlClient`: commands reach the drive of a control box at once."""

    def __init__(self, box: ControlBox, host: str, watchdog: float, failed: Callable[[str], None]) -> None:
        del host, watchdog, failed
        self.process: object | None = None
        self.ready, self.ended = False, asyncio.Event()
        self._box = box

    def start(self) -> None:
        self.process, self.ready = self, True

    def send(self, command: Command) -> None:
        drive = self._box.drive
        if self._box.safety_mode != SafetyMode.NORMAL:
            return
        match command:
            case MoveTo(pose, speed, acceleration):
                drive.line(np.array(pose), speed, acceleration)
            case Move(velocity, acceleration):
                drive.speed(np.array(velocity), acceleration)
            case Signal.STOP if drive.task == "speed":
                drive.speed(np.zeros(6), STOP_DECELERATION)
            case Signal.STOP | Signal.RELEASE if drive.task != "none":
                drive.stop(STOP_DECELERATION)
            case _:
                pass

    async def keep_alive(self) -> None:
        await self.ended.wait()

    async def close(self) -> None:
        self.process = None
        self.ended.set()

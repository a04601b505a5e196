"""Process that commands a UR arm through ur-rtde's RTDEControlInterface, which can crash.

The process stops the arm if it receives no command for `SILENCE`. If the process itself dies, the
controller's watchdog ends the control script, which stops the arm.

A velocity and a kick are written to the same register, which the controller reads once per cycle: if two
writes fall into one cycle, the first is lost. So this process never kicks during velocity control. Instead it
repeats the velocity, including 0, until `RELEASE`: each write counts as a kick, and replaces a lost one.

A controller accepts one such client at a time. ur-rtde supports RTDE port 30004 only.
"""

import asyncio
import multiprocessing
import signal
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from enum import Enum, auto
from importlib import import_module
from math import hypot
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from time import monotonic
from typing import Any, Final, Literal, NamedTuple, TypeAlias

from connectors.ur.ur_state import Pose
from operators.errors import EndpointError

START_TIMEOUT: Final = 30.0  # s; the process imports ur-rtde and uploads a program
HUNG: Final = 2.0  # s without a reply, after which the process counts as hung
SILENCE: Final = 0.5  # s without a command until the arm is stopped; longer for a slow watchdog
REPEAT: Final = 0.05  # s, longest time between two writes to the controller
WATCHDOG: Final = 5.0  # Hz, minimum rate of writes that the controller requires
STOP_DECELERATION: Final = 2.0  # m/s2 and rad/s2
_POLL: Final = 0.01  # s
_HEARTBEAT: Final = 0.1  # s between replies, and between keep-alive commands


@dataclass(frozen=True, slots=True)
class MoveTo:
    """Command to move in a straight line to a pose and stop there."""

    pose: Pose
    speed: float  # m/s
    acceleration: float  # m/s2


@dataclass(frozen=True, slots=True)
class Move:
    """Command to move with a velocity until the next command."""

    velocity: Pose  # m/s, rad/s
    acceleration: float  # m/s2, rad/s2


class Signal(Enum):
    """Command without parameters."""

    STOP = auto()  # come to rest at once
    RELEASE = auto()  # end velocity control once the arm stands still
    KEEP_ALIVE = auto()  # no effect; it shows that the commanding process is alive
    END = auto()  # stop the arm and end the process


_STANDSTILL: Final = Move((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), STOP_DECELERATION)

Command: TypeAlias = MoveTo | Move | Signal


class Reply(NamedTuple):
    """Message from the process."""

    kind: Literal["ready", "alive", "failed"]
    text: str = ""


def connect(host: str) -> Any:
    """Connect ur-rtde, which uploads its control script to the controller and starts it.

    Raises:
        EndpointError: if the controller does not accept it.
    """
    try:
        return import_module("rtde_control").RTDEControlInterface(host)
    except RuntimeError as error:
        reason = f"cannot be commanded: {error}; does another program control it, is it in remote control?"
        raise EndpointError(f"ur://{host}", reason) from error


def serve(
    pipe: Connection, host: str, watchdog: float = WATCHDOG, connect: Callable[[str], Any] = connect
) -> None:
    """Execute commands from a pipe until `Signal.END`, an error or silence; main function of the process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # the commanding process ends this one
        signal.signal(number, signal.SIG_IGN)
    try:
        control = connect(host)
    except EndpointError as error:
        pipe.send(Reply("failed", error.reason))
        return
    commander = _Commander(control)
    try:
        control.setWatchdog(watchdog)
        pipe.send(Reply("ready"))
        commander.run(pipe, watchdog)
    except (EOFError, OSError):  # the commanding process has died
        pass
    except RuntimeError as error:
        pipe.send(Reply("failed", str(error)))
    finally:
        with ExitStack() as ending:  # all three, even if the first fails
            ending.callback(control.disconnect)
            ending.callback(control.stopScript)
            commander.stop()


class _Commander:
    """Sender of commands to the controller; it does not wait until they are done."""

    def __init__(self, control: Any) -> None:
        self._control = control
        self._mode: Literal["rest", "line", "velocity"] = "rest"
        self._velocity = _STANDSTILL  # newest command in velocity mode

    def run(self, pipe: Connection, watchdog: float) -> None:
        """Execute commands until `END`; write to the controller at least three times per watchdog period."""
        silence, period = max(SILENCE, 1 / watchdog), min(REPEAT, 1 / watchdog / 3)  # s
        received = monotonic()
        written, replied = received, received - _HEARTBEAT
        while True:
            if pipe.poll(_POLL):
                command: Command = pipe.recv()
                received = monotonic()
                if command is Signal.END:
                    return
                self._execute(command)
            now = monotonic()
            if now - received > silence:
                raise RuntimeError(f"no command for {silence:g} s: the arm was stopped")
            if now - written > period:
                written = now
                if not self._repeat():
                    raise RuntimeError(
                        "the controller ended the control program: it was stopped there, or by the watchdog"
                        f" after {1 / watchdog:g} s without a message (watchdog {watchdog:g} Hz)"
                    )
            if now - replied > _HEARTBEAT:
                replied = now
                pipe.send(Reply("alive"))

    def stop(self) -> None:
        """Begin to bring the arm to rest."""
        if self._mode == "line":
            self._control.stopL(STOP_DECELERATION, True)
            self._mode = "rest"
        elif self._mode == "velocity":
            self._move(_STANDSTILL)  # repeated until `Signal.RELEASE`

    def _execute(self, command: Command) -> None:
        done = True
        match command:
            case MoveTo(pose, speed, acceleration):
                self._end_velocity()
                self._mode = "line"
                done = self._control.moveL([*pose], speed, acceleration, True)
            case Move(velocity, acceleration):
                used = acceleration if hypot(*velocity) else max(acceleration, 0.1)
                done = self._move(Move(velocity, used))
            case Signal.STOP:
                self.stop()
            case Signal.RELEASE:
                self._end_velocity()
        if not done:
            raise RuntimeError(f"the controller rejects the command {type(command).__name__}")

    def _move(self, command: Move) -> bool:
        self._mode, self._velocity = "velocity", command
        return bool(self._control.speedL([*command.velocity], command.acceleration, 0.0))

    def _repeat(self) -> bool:
        """Write to the controller: repeat the velocity, which may have been lost, or kick the watchdog."""
        return self._move(self._velocity) if self._mode == "velocity" else bool(self._control.kickWatchdog())

    def _end_velocity(self) -> None:
        if self._mode == "velocity":
            self._control.speedStop(STOP_DECELERATION)
            self._mode = "rest"


class ControlClient:
    """Client that starts, commands, monitors and ends the process.

    Args:
        host: Address of the controller.
        watchdog: Minimum rate of writes that the controller requires, Hz.
        failed: Called with a reason when the process fails, dies or hangs.

    Attributes:
        process: The process; None before `start` and after `close`.
        ready: True once the controller accepts commands.
        ended: Event, set once the process can receive no more commands.
    """

    def __init__(self, host: str, watchdog: float, failed: Callable[[str], None]) -> None:
        self.process: SpawnProcess | None = None
        self.ready, self.ended = False, asyncio.Event()
        self._host, self._watchdog, self._failed = host, watchdog, failed
        self._pipe: Connection | None = None
        self._closing = False
        self._replied = 0.0  # loop time (s) of the newest reply

    def start(self) -> None:
        """Start the process."""
        context = multiprocessing.get_context("spawn")  # a fork would inherit the event loop and threads
        ours, theirs = context.Pipe()
        process = context.Process(
            target=serve, args=(theirs, self._host, self._watchdog), name=f"arm {self._host}", daemon=True
        )
        with theirs:
            process.start()
        self._pipe, self.process = ours, process
        loop = asyncio.get_running_loop()
        self._replied = loop.time() + START_TIMEOUT
        loop.add_reader(self._pipe.fileno(), self._read_replies)

    def send(self, command: Command) -> None:
        """Send a command; without a process it has no effect."""
        if self._pipe:
            with suppress(OSError):  # the process has died; `_read_replies` reports it
                self._pipe.send(command)

    async def keep_alive(self) -> None:
        """Send keep-alive messages to the process, and check its replies, until it ends."""
        loop = asyncio.get_running_loop()
        while not self.ended.is_set():
            if self.ready:  # a pipe that is not read is full after 28 s, and then blocks the event loop
                self.send(Signal.KEEP_ALIVE)
            if loop.time() - self._replied > HUNG:
                self._failed(f"the process that commands it has not replied for {HUNG} s")
            await asyncio.sleep(_HEARTBEAT)

    async def close(self) -> None:
        """End the process; kill it if it does not end in time."""
        if not (process := self.process):
            return
        self._closing = True
        self.send(Signal.END)
        with suppress(TimeoutError):
            async with asyncio.timeout(HUNG):
                await self.ended.wait()
        self.process = None
        if not self.ended.is_set():
            process.kill()
        await asyncio.to_thread(process.join, HUNG)
        self._close_pipe()

    def _read_replies(self) -> None:
        assert self._pipe
        try:
            while self._pipe.poll():
                reply: Reply = self._pipe.recv()
                self._replied = asyncio.get_running_loop().time()
                if reply.kind == "ready":
                    self.ready = True
                elif reply.kind == "failed":
                    self._failed(reply.text)
        except (EOFError, OSError):
            self._close_pipe()
            if not self._closing:
                self._failed("the process that commands it died; the controller's watchdog stops the arm")

    def _close_pipe(self) -> None:
        self.ended.set()
        if self._pipe:
            asyncio.get_running_loop().remove_reader(self._pipe.fileno())
            self._pipe.close()
            self._pipe = None

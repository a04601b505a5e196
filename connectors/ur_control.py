"""The process that commands a UR arm through ur-rtde's RTDEControlInterface, which can crash: alone in it.

It stops the arm when nobody has talked to it for `SILENCE`. If it dies itself, the controller misses the
watchdog's kicks, ends the control script and so stops the arm by itself.

A controller has one client of this kind at a time. ur-rtde knows one RTDE port only, 30004.
"""

import signal
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from math import hypot
from multiprocessing.connection import Connection
from time import monotonic
from typing import Final, Literal, NamedTuple, Protocol, TypeAlias, cast

from operators.errors import EndpointError

SILENCE: Final = 0.5  # s without an order after which the arm is stopped
WATCHDOG: Final = 5.0  # Hz at which the controller must hear of us at least
HARD: Final = 2.0  # m/s2 and rad/s2 of a stop
_TURN: Final = 0.01  # s, for an order to come
_TELL: Final = 0.1  # s from word to word

Vector: TypeAlias = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Line:
    """Go straight to a pose and stop there."""

    pose: Vector  # m, rotation vector in rad
    speed: float  # m/s
    acceleration: float  # m/s2


@dataclass(frozen=True, slots=True)
class Go:
    """Go on with a velocity, until the next order."""

    velocity: Vector  # m/s, rad/s
    acceleration: float  # m/s2, rad/s2


@dataclass(frozen=True, slots=True)
class Stop:
    """Come to rest at once."""


@dataclass(frozen=True, slots=True)
class Rest:
    """The arm stands: no velocity is to be kept up any more."""


@dataclass(frozen=True, slots=True)
class Alive:
    """Nothing; who orders is there."""


@dataclass(frozen=True, slots=True)
class End:
    """Stop and end the process."""


Order: TypeAlias = Line | Go | Stop | Rest | Alive | End


class Word(NamedTuple):
    """What the process says of itself."""

    kind: Literal["ready", "alive", "failed"]
    text: str = ""


class Control(Protocol):
    """What is used of ur-rtde's RTDEControlInterface."""

    def moveL(self, pose: list[float], speed: float, acceleration: float, asynchronous: bool, /) -> bool: ...  # noqa: D102, N802, FBT001
    def speedL(self, velocity: list[float], acceleration: float, time: float, /) -> bool: ...  # noqa: D102, N802
    def speedStop(self, deceleration: float, /) -> bool: ...  # noqa: D102, N802
    def stopL(self, deceleration: float, asynchronous: bool, /) -> None: ...  # noqa: D102, N802, FBT001
    def setWatchdog(self, rate: float, /) -> bool: ...  # noqa: D102, N802
    def kickWatchdog(self) -> bool: ...  # noqa: D102, N802
    def stopScript(self) -> None: ...  # noqa: D102, N802
    def disconnect(self) -> None: ...  # noqa: D102


def connect(host: str) -> Control:
    """The real interface: uploads its program to the controller, which begins to run it.

    Raises:
        EndpointError: if ur-rtde is not installed, or the controller is not to be commanded.
    """
    try:
        library = import_module("rtde_control")
    except ImportError as error:
        reason = f"commanding it needs ur-rtde: pip install 'slipflow[ur]' ({error})"
        raise EndpointError(f"ur://{host}", reason) from error
    try:
        return cast("Callable[[str], Control]", library.RTDEControlInterface)(host)
    except RuntimeError as error:
        raise EndpointError(f"ur://{host}", f"cannot be commanded: {error}") from error


def serve(
    pipe: Connection, host: str, watchdog: float = WATCHDOG, connect: Callable[[str], Control] = connect
) -> None:
    """Carry out orders that come by a pipe until `End`, an error, or silence; what the process runs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who orders, who tells us to stop
    try:
        control = connect(host)
    except EndpointError as error:
        pipe.send(Word("failed", error.reason))
        return
    operator = _Operator(control)
    try:
        control.setWatchdog(watchdog)
        pipe.send(Word("ready"))
        operator.follow(pipe, 1 / watchdog / 3)
    except (EOFError, OSError):  # who orders is gone
        pass
    except RuntimeError as error:
        pipe.send(Word("failed", str(error)))
    finally:
        operator.stop()
        control.stopScript()
        control.disconnect()


class _Operator:
    """Carries orders out, none of which it waits for."""

    def __init__(self, control: Control) -> None:
        self._control = control
        self._doing: Literal["rest", "line", "go"] = "rest"

    def follow(self, pipe: Connection, kick: float) -> None:
        """Take orders until the end, kicking the controller's watchdog every `kick` s.

        Raises:
            RuntimeError: if the controller does not obey, or nobody orders.
        """
        heard = monotonic()
        kicked = told = heard - 1.0
        while True:
            if pipe.poll(_TURN):
                order: Order = pipe.recv()
                heard = monotonic()
                if isinstance(order, End):
                    return
                self._obey(order)
            now = monotonic()
            if now - heard > SILENCE:
                raise RuntimeError(f"nobody has talked to the arm for {SILENCE} s: it was stopped")
            if now - kicked > kick:
                kicked = now
                if not self._control.kickWatchdog():
                    raise RuntimeError("the controller does not listen any more")
            if now - told > _TELL:
                told = now
                pipe.send(Word("alive"))

    def stop(self) -> None:
        """Come to rest, without waiting for it."""
        if self._doing == "line":
            self._control.stopL(HARD, True)  # noqa: FBT003 - positional in ur-rtde
        elif self._doing == "go":
            self._control.speedL([0.0] * 6, HARD, 0.0)
            return  # the velocity, which is none, is kept up until `Rest`
        self._doing = "rest"

    def _obey(self, order: Order) -> None:
        done = True
        match order:
            case Line(pose, speed, acceleration):
                self._end_velocity()
                self._doing = "line"
                done = self._control.moveL([*pose], speed, acceleration, True)  # noqa: FBT003
            case Go(velocity, acceleration):
                gentle = acceleration if hypot(*velocity) else max(acceleration, 0.1)
                self._doing = "go"
                done = self._control.speedL([*velocity], gentle, 0.0)
            case Stop():
                self.stop()
            case Rest():
                self._end_velocity()
                self._doing = "rest"
            case _:
                pass
        if not done:
            raise RuntimeError(f"the controller does not carry out {type(order).__name__}")

    def _end_velocity(self) -> None:
        if self._doing == "go":
            self._control.speedStop(HARD)
            self._doing = "rest"

"""The process that commands a UR arm through ur-rtde's RTDEControlInterface, which can crash: alone in it.

It stops the arm when nobody has talked to it for `SILENCE`. If it dies itself, the controller misses the
watchdog's kicks, ends the control script and so stops the arm by itself.

A velocity and a kick are written to the same register of the controller, which looks at it once a cycle: of
two that come within a cycle the first is lost. So nothing is kicked while the arm goes by velocities. The
velocity itself is sent again instead, 0 until `Rest`: any command counts as a kick, and no order stays lost.

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

SILENCE: Final = 0.5  # s without an order after which the arm is stopped; longer if the watchdog is
REMIND: Final = 0.05  # s at most from reminder to reminder of the controller
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
    """The arm is seen to stand: no velocity, not even that of 0, is to be kept up any more."""


@dataclass(frozen=True, slots=True)
class Alive:
    """Nothing; who orders is there."""


@dataclass(frozen=True, slots=True)
class End:
    """Stop and end the process."""


_STOP: Final = Go((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), HARD)

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
        reason = f"commanding it needs ur-rtde: in the clone, pip install -e '.[ur]' ({error})"
        raise EndpointError(f"ur://{host}", reason) from error
    try:
        return cast("Callable[[str], Control]", library.RTDEControlInterface)(host)
    except RuntimeError as error:
        reason = (
            f"cannot be commanded: {error}; is another program in control, or the arm not in remote control?"
        )
        raise EndpointError(f"ur://{host}", reason) from error


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
        operator.follow(pipe, watchdog)
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
        self._going = _STOP  # the newest velocity, while it goes

    def follow(self, pipe: Connection, watchdog: float) -> None:
        """Take orders until the end, reminding the controller three times as often as it has to be, or more.

        Raises:
            RuntimeError: if the controller does not obey, or nobody orders.
        """
        silence, every = max(SILENCE, 1 / watchdog), min(REMIND, 1 / watchdog / 3)  # s
        heard = monotonic()
        reminded, told = heard, heard - _TELL
        while True:
            if pipe.poll(_TURN):
                order: Order = pipe.recv()
                heard = monotonic()
                if isinstance(order, End):
                    return
                self._obey(order)
            now = monotonic()
            if now - heard > silence:
                raise RuntimeError(f"nobody has talked to the arm for {silence:g} s: it was stopped")
            if now - reminded > every:
                reminded = now
                if not self._remind():
                    raise RuntimeError(
                        "the controller ended our program: stopped there, or by its watchdog, as when it"
                        f" hears nothing of us for {1 / watchdog:g} s (--watchdog {watchdog:g})"
                    )
            if now - told > _TELL:
                told = now
                pipe.send(Word("alive"))

    def stop(self) -> None:
        """Come to rest, without waiting for it."""
        if self._doing == "line":
            self._control.stopL(HARD, True)  # noqa: FBT003 - positional in ur-rtde
            self._doing = "rest"
        elif self._doing == "go":
            self._go(_STOP)  # kept up until `Rest`

    def _obey(self, order: Order) -> None:
        done = True
        match order:
            case Line(pose, speed, acceleration):
                self._end_velocity()
                self._doing = "line"
                done = self._control.moveL([*pose], speed, acceleration, True)  # noqa: FBT003
            case Go(velocity, acceleration):
                gentle = acceleration if hypot(*velocity) else max(acceleration, 0.1)
                done = self._go(Go(velocity, gentle))
            case Stop():
                self.stop()
            case Rest():
                self._end_velocity()
                self._doing = "rest"
            case _:
                pass
        if not done:
            raise RuntimeError(f"the controller does not carry out {type(order).__name__}")

    def _go(self, order: Go) -> bool:
        self._doing, self._going = "go", order
        return self._control.speedL([*order.velocity], order.acceleration, 0.0)

    def _remind(self) -> bool:
        """Let the controller hear of us; a velocity that it may have missed once more."""
        return self._go(self._going) if self._doing == "go" else self._control.kickWatchdog()

    def _end_velocity(self) -> None:
        if self._doing == "go":
            self._control.speedStop(HARD)
            self._doing = "rest"

import multiprocessing
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any

import pytest

from connectors.ur import control_process as ur_control
from connectors.ur.control_process import Alive, End, Go, Line, Order, Rest, Stop, Word, serve
from operators import EndpointError

POSE = (0.4, 0.0, 0.1, 3.14, 0.0, 0.0)
FORWARD = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass
class TestControl:
    """Remembers what ur-rtde would be told, kicks apart."""

    __test__ = False
    told: list[tuple[Any, ...]] = field(default_factory=list[tuple[Any, ...]])
    obeys: bool = True

    def moveL(self, pose: list[float], speed: float, acceleration: float, asynchronous: bool, /) -> bool:  # noqa: N802, FBT001
        self.told.append(("moveL", pose, speed, acceleration, asynchronous))
        return self.obeys

    def speedL(self, velocity: list[float], acceleration: float, time: float, /) -> bool:  # noqa: N802
        self.told.append(("speedL", velocity, acceleration, time))
        return self.obeys

    def speedStop(self, deceleration: float, /) -> bool:  # noqa: N802
        self.told.append(("speedStop",))
        return self.obeys

    def stopL(self, deceleration: float, asynchronous: bool, /) -> None:  # noqa: N802, FBT001
        self.told.append(("stopL", asynchronous))

    def setWatchdog(self, rate: float, /) -> bool:  # noqa: N802
        self.told.append(("setWatchdog", rate))
        return True

    def kickWatchdog(self) -> bool:  # noqa: N802
        return True

    def stopScript(self) -> None:  # noqa: N802
        self.told.append(("stopScript",))

    def disconnect(self) -> None:
        self.told.append(("disconnect",))


@dataclass
class Slow(TestControl):
    """Looks at the register that commands are written to at every second write only, as in a long cycle."""

    writes: int = 0
    velocity: list[float] | None = None  # that the arm goes with
    _register: list[float] | None = None  # None: no command

    def speedL(self, velocity: list[float], acceleration: float, time: float, /) -> bool:  # noqa: N802
        self._write(velocity)
        return super().speedL(velocity, acceleration, time)

    def kickWatchdog(self) -> bool:  # noqa: N802
        self._write(None)
        return True

    def _write(self, command: list[float] | None) -> None:
        self._register = command
        self.writes += 1
        if self.writes % 2 == 0 and self._register is not None:
            self.velocity = self._register


def calls(control: TestControl) -> list[tuple[Any, ...]]:
    """What ur-rtde would be told, without its repeats."""
    return [call for call, _ in groupby(control.told)]


def ignored(number: int, handler: object) -> None:
    """Only a main thread may set what a signal does."""


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Connection, Connection]]:
    monkeypatch.setattr("connectors.ur.control_process.signal.signal", ignored)
    ours, theirs = multiprocessing.Pipe()
    yield ours, theirs
    ours.close()
    theirs.close()


def begin(pipe: Connection, control: TestControl) -> None:
    def connect(host: str) -> TestControl:
        assert host == "robot"
        return control

    serve(pipe, "robot", 5.0, connect)


def served(pipe: tuple[Connection, Connection], control: TestControl, *orders: Order) -> list[Word]:
    """What the process says to orders, until it ends."""
    ours, theirs = pipe
    thread = Thread(target=begin, args=(theirs, control))
    thread.start()
    for order in orders:
        ours.send(order)
    thread.join(10)
    assert not thread.is_alive()
    words = list[Word]()
    while ours.poll():
        words.append(ours.recv())
    return [word for word in words if word.kind != "alive"]


def test_orders_become_calls_that_wait_for_nothing(pipe: tuple[Connection, Connection]) -> None:
    control = TestControl()
    words = served(pipe, control, Line(POSE, 0.1, 0.5), Alive(), Go(FORWARD, 0.5), Stop(), Rest(), End())
    assert words == [Word("ready")]
    assert calls(control) == [
        ("setWatchdog", 5.0),
        ("moveL", [*POSE], 0.1, 0.5, True),
        ("speedL", [*FORWARD], 0.5, 0.0),
        ("speedL", [0.0] * 6, ur_control.HARD, 0.0),
        ("speedStop",),
        ("stopScript",),
        ("disconnect",),
    ]


@pytest.mark.parametrize("phase", [0, 1])
def test_no_velocity_is_lost_to_a_kick_in_the_same_cycle(
    pipe: tuple[Connection, Connection], phase: int
) -> None:
    control, (ours, theirs) = Slow(writes=phase), pipe
    thread = Thread(target=begin, args=(theirs, control))
    thread.start()
    for velocity in (FORWARD, STILL):
        ours.send(Go(velocity, 0.5))
        reached = control.writes + 4
        while control.writes < reached:  # whoever orders talks on
            assert ours.recv()
            ours.send(Alive())
        assert control.velocity == [*velocity]
    ours.send(Stop())
    ours.send(End())
    thread.join(10)
    assert not thread.is_alive()


def test_a_stop_is_kept_up_until_the_arm_is_seen_to_stand(pipe: tuple[Connection, Connection]) -> None:
    control, (ours, theirs) = TestControl(), pipe
    thread = Thread(target=begin, args=(theirs, control))
    thread.start()
    ours.send(Go(FORWARD, 0.5))
    ours.send(Stop())
    stopped = ("speedL", [0.0] * 6, ur_control.HARD, 0.0)
    while control.told.count(stopped) < 3:
        assert ours.recv()
        ours.send(Alive())
    ours.send(Rest())
    ours.send(End())
    thread.join(10)
    assert control.told[-3:] == [("speedStop",), ("stopScript",), ("disconnect",)]


def test_a_program_that_ended_says_what_may_have_ended_it(pipe: tuple[Connection, Connection]) -> None:
    class Ended(TestControl):
        def kickWatchdog(self) -> bool:  # noqa: N802
            return False

    words = served(pipe, Ended())
    assert words[-1].kind == "failed"
    assert "nothing of us for 0.2 s (--watchdog 5)" in words[-1].text


def test_a_line_is_stopped_and_a_velocity_ended_before_a_line(pipe: tuple[Connection, Connection]) -> None:
    control = TestControl()
    served(pipe, control, Go(FORWARD, 0.5), Line(POSE, 0.1, 0.5), Stop(), End())
    assert [call[0] for call in calls(control)[1:-2]] == ["speedL", "speedStop", "moveL", "stopL"]


def test_the_arm_is_stopped_when_nobody_talks_any_more(
    pipe: tuple[Connection, Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur_control, "SILENCE", 0.05)
    control = TestControl()
    *_, last = served(pipe, control, Line(POSE, 0.1, 0.5))
    assert last.text == "nobody has talked to the arm for 0.2 s: it was stopped"  # as patient as the watchdog
    assert last.kind == "failed"
    assert [call[0] for call in control.told[-3:]] == ["stopL", "stopScript", "disconnect"]


def test_the_arm_is_stopped_when_who_orders_is_gone(pipe: tuple[Connection, Connection]) -> None:
    ours, theirs = pipe
    control = TestControl()
    ours.send(Line(POSE, 0.1, 0.5))
    thread = Thread(target=begin, args=(theirs, control))
    thread.start()
    while ours.recv().kind != "alive":
        pass
    ours.close()
    thread.join(10)
    assert [call[0] for call in control.told[-3:]] == ["stopL", "stopScript", "disconnect"]


def test_a_controller_that_does_not_obey_ends_it(pipe: tuple[Connection, Connection]) -> None:
    words = served(pipe, TestControl(obeys=False), Line(POSE, 0.1, 0.5))
    assert words[-1] == Word("failed", "the controller does not carry out Line")


def test_without_ur_rtde_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(ur_control, "import_module", missing)
    with pytest.raises(EndpointError, match=r"pip install -e '\.\[ur\]'"):
        ur_control.connect("robot")

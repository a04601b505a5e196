import multiprocessing
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any

import pytest

from connectors import ur_control
from connectors.ur_control import Alive, End, Go, Line, Order, Rest, Stop, Word, serve
from operators import EndpointError

POSE = (0.4, 0.0, 0.1, 3.14, 0.0, 0.0)
FORWARD = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)


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


def ignored(number: int, handler: object) -> None:
    """Only a main thread may set what a signal does."""


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Connection, Connection]]:
    monkeypatch.setattr("connectors.ur_control.signal.signal", ignored)
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
    assert control.told == [
        ("setWatchdog", 5.0),
        ("moveL", [*POSE], 0.1, 0.5, True),
        ("speedL", [*FORWARD], 0.5, 0.0),
        ("speedL", [0.0] * 6, ur_control.HARD, 0.0),
        ("speedStop",),
        ("stopScript",),
        ("disconnect",),
    ]


def test_a_line_is_stopped_and_a_velocity_ended_before_a_line(pipe: tuple[Connection, Connection]) -> None:
    control = TestControl()
    served(pipe, control, Go(FORWARD, 0.5), Line(POSE, 0.1, 0.5), Stop(), End())
    assert [call[0] for call in control.told[1:-2]] == ["speedL", "speedStop", "moveL", "stopL"]


def test_the_arm_is_stopped_when_nobody_talks_any_more(
    pipe: tuple[Connection, Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur_control, "SILENCE", 0.05)
    control = TestControl()
    *_, last = served(pipe, control, Line(POSE, 0.1, 0.5))
    assert last.kind == "failed"
    assert "nobody has talked" in last.text
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
    with pytest.raises(EndpointError, match=r"pip install 'slipflow\[ur\]'"):
        ur_control.connect("robot")

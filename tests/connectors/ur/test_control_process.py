import asyncio
import multiprocessing
import os
import signal
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import groupby
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any
from unittest.mock import MagicMock

import pytest

from connectors.ur import control_process
from connectors.ur.control_process import Command, ControlClient, Move, MoveTo, Reply, Signal, serve
from tests.loopback import own_host
from tests.waiting import PATIENCE

POSE = (0.4, 0.0, 0.1, 3.14, 0.0, 0.0)
FORWARD = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)


def calls(control: MagicMock) -> list[tuple[Any, ...]]:
    """Return the calls to ur-rtde but kicks, without repeats."""
    made = [(name, *values) for name, values, _ in control.method_calls if name != "kickWatchdog"]
    return [call for call, _ in groupby(made)]


def ended(control: MagicMock) -> list[str]:
    """Return the names of the last three calls."""
    return [call[0] for call in calls(control)[-3:]]


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Connection, Connection]]:
    handle = MagicMock()  # only a main thread may set signal handlers
    monkeypatch.setattr("connectors.ur.control_process.signal.signal", handle)
    ours, theirs = multiprocessing.Pipe()
    yield ours, theirs
    ours.close()
    theirs.close()


def begin(pipe: Connection, control: MagicMock) -> None:
    def connect(host: str) -> MagicMock:
        assert host == "robot"
        return control

    serve(pipe, "robot", 5.0, connect)


def started(pipe: Connection, control: MagicMock) -> Thread:
    thread = Thread(target=begin, args=(pipe, control))
    thread.start()
    return thread


def served(pipe: tuple[Connection, Connection], control: MagicMock, *commands: Command) -> list[Reply]:
    """Return the replies of the process to commands, until it ends."""
    ours, theirs = pipe
    thread = started(theirs, control)
    for command in commands:
        ours.send(command)
    thread.join(10)
    assert not thread.is_alive()
    replies = list[Reply]()
    while ours.poll():
        replies.append(ours.recv())
    return [reply for reply in replies if reply.kind != "alive"]


def test_commands_become_asynchronous_calls(pipe: tuple[Connection, Connection]) -> None:
    control = MagicMock()
    replies = served(
        pipe,
        control,
        MoveTo(POSE, 0.1, 0.5),
        Signal.KEEP_ALIVE,
        Move(FORWARD, 0.5),
        Signal.STOP,
        Signal.RELEASE,
        Signal.END,
    )
    assert replies == [Reply("ready")]
    assert calls(control) == [
        ("setWatchdog", 5.0),
        ("moveL", [*POSE], 0.1, 0.5, True),
        ("speedL", [*FORWARD], 0.5, 0.0),
        ("speedL", [0.0] * 6, control_process.STOP_DECELERATION, 0.0),
        ("speedStop", control_process.STOP_DECELERATION),
        ("stopScript",),
        ("disconnect",),
    ]


def test_a_stop_is_repeated_until_release(pipe: tuple[Connection, Connection]) -> None:
    control, (ours, theirs) = MagicMock(), pipe
    thread = started(theirs, control)
    ours.send(Move(FORWARD, 0.5))
    ours.send(Signal.STOP)
    stopped = ("speedL", [0.0] * 6, control_process.STOP_DECELERATION, 0.0)
    while [(name, *values) for name, values, _ in control.method_calls].count(stopped) < 3:
        assert ours.recv()
        ours.send(Signal.KEEP_ALIVE)
    ours.send(Signal.RELEASE)
    ours.send(Signal.END)
    thread.join(10)
    assert ended(control) == ["speedStop", "stopScript", "disconnect"]


def test_an_ended_program_is_reported_with_possible_causes(pipe: tuple[Connection, Connection]) -> None:
    control = MagicMock()
    control.kickWatchdog.return_value = False
    replies = served(pipe, control)
    assert replies[-1].kind == "failed"
    assert "after 0.2 s without a message (watchdog 5 Hz)" in replies[-1].text


def test_the_arm_is_stopped_when_no_command_arrives(
    pipe: tuple[Connection, Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_process, "SILENCE", 0.05)
    control = MagicMock()
    *_, last = served(pipe, control, MoveTo(POSE, 0.1, 0.5))
    assert last.text == "no command for 0.2 s: the arm was stopped"  # the watchdog's period
    assert last.kind == "failed"
    assert ended(control) == ["stopL", "stopScript", "disconnect"]


def test_the_arm_is_stopped_when_the_commanding_process_is_gone(pipe: tuple[Connection, Connection]) -> None:
    ours, theirs = pipe
    control = MagicMock()
    ours.send(MoveTo(POSE, 0.1, 0.5))
    thread = started(theirs, control)
    while ours.recv().kind != "alive":
        pass
    ours.close()
    thread.join(10)
    assert ended(control) == ["stopL", "stopScript", "disconnect"]


def controlled(_: str) -> MagicMock:
    return MagicMock()


def test_a_signal_to_the_whole_process_group_does_not_end_it() -> None:
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=serve, args=(theirs, "robot", 5.0, controlled)
    )
    process.start()
    assert process.pid
    assert ours.recv() == Reply("ready")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(process.pid, number)
    ours.send(Signal.END)
    process.join(PATIENCE)
    assert process.exitcode == 0


def test_the_process_disconnects_even_if_no_stop_is_possible(pipe: tuple[Connection, Connection]) -> None:
    control, (ours, theirs) = MagicMock(), pipe
    control.stopL.side_effect = RuntimeError("connection lost")
    ours.send(MoveTo(POSE, 0.1, 0.5))
    ours.send(Signal.END)
    with pytest.raises(RuntimeError, match="connection lost"):
        begin(theirs, control)
    assert ended(control) == ["stopL", "stopScript", "disconnect"]


def test_a_rejected_command_ends_the_process(pipe: tuple[Connection, Connection]) -> None:
    control = MagicMock()
    control.moveL.return_value = False
    replies = served(pipe, control, MoveTo(POSE, 0.1, 0.5))
    assert replies[-1] == Reply("failed", "the controller rejects the command MoveTo")


@pytest.mark.virtual
async def test_the_pipe_to_a_process_that_starts_does_not_fill_up() -> None:
    client, (ours, theirs) = ControlClient("robot", 5.0, list[str]().append), multiprocessing.Pipe()
    client._pipe, client._replied = ours, 10.0
    keeping = asyncio.create_task(client.keep_alive())
    await asyncio.sleep(1.0)
    assert not theirs.poll()
    keeping.cancel()


@pytest.mark.skipif(find_spec("rtde_control") is None, reason="needs the extra `ur`")
async def test_a_controller_that_cannot_be_commanded_is_reported() -> None:
    reasons = list[str]()
    client = ControlClient(own_host(9), 5.0, reasons.append)  # nothing listens there
    client.start()
    async with asyncio.timeout(PATIENCE):
        await client.ended.wait()
    await client.close()
    assert reasons[0].startswith("cannot be commanded: ")
    assert not client.ready

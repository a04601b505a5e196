"""An arm on the emulated controller: in virtual time, and commanded by the real RTDEControlInterface."""

import asyncio
import importlib.util
import math
import os
import re
import signal
from collections.abc import AsyncGenerator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

import numpy as np
import pytest

from connectors.ur.control_process import STOP_DECELERATION, Command, Move, MoveTo, Signal
from connectors.ur.ur_arm import _STEERING, PATH_TOLERANCE, UrArm, request_stop
from connectors.ur.ur_state import ArmState, Bounds
from flows.graph.testing import VirtualLoop
from flows.run.clocks import LoopClock
from operators import EndpointError
from tests.emulators.ur_control_box import ControlBox, RuntimeState, SafetyMode
from tests.emulators.ur_controller import ANYWHERE, CB3, E_SERIES, UrController
from tests.emulators.ur_program import Program
from tests.loopback import own_host

real = pytest.mark.skipif(importlib.util.find_spec("rtde_control") is None, reason="needs the extra `ur`")

HOST = own_host(2)
BEGIN = (0.4, 0.0, 0.1, math.pi, 0.0, 0.0)
BOUNDS = Bounds((0.3, -0.1, 0.05), (0.5, 0.1, 0.2), force=20.0)
NEWEST = (5, 24, 0, 1)


class DirectControl:
    """Stand-in for `ControlClient`, for virtual time: commands reach the drive of a control box at once."""

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

    async def keep_alive(self) -> None:
        await self.ended.wait()

    async def close(self) -> None:
        self.process = None
        self.ended.set()


@dataclass
class Lab:
    controller: UrController
    arm: UrArm


@asynccontextmanager
async def lab(version: tuple[int, ...] = CB3) -> AsyncGenerator[Lab]:
    """Serve an arm; in virtual time `DirectControl` commands it, else ur-rtde."""
    clock, loop = LoopClock(), asyncio.get_running_loop()
    async with UrController(np.array(BEGIN), host=HOST, version=version, now=clock.now) as controller:
        with pytest.MonkeyPatch.context() as patch:
            if isinstance(loop, VirtualLoop):
                patch.setattr("connectors.ur.ur_arm.ControlClient", partial(DirectControl, controller.box))
            moved = UrArm(HOST, BOUNDS, clock, watchdog=0.1)
        async with moved:
            yield Lab(controller, moved)


async def refused(
    act: Callable[[Lab], None] | None, move: Callable[[UrArm], Coroutine[Any, Any, None]]
) -> Lab:
    """Return a lab whose arm was stopped during a move, because of what `act` does after 0.3 s, if given."""
    async with lab() as here:
        if act:
            asyncio.get_running_loop().call_later(0.3, act, here)
        with pytest.raises(EndpointError):
            await move(here.arm)
        await here.arm.stop()
        assert here.arm.state.still
        with pytest.raises(EndpointError):  # for good
            await here.arm.line([BEGIN], 0.1, 0.5, 1.0)
    return here


def away(arm: UrArm) -> Coroutine[Any, Any, None]:
    return arm.turn(0.2, 4.0, 0.5)


@real
@pytest.mark.parametrize("version", [CB3, E_SERIES, NEWEST], ids=str)
async def test_it_moves_along_lines_and_turns(version: tuple[int, ...]) -> None:
    async with lab(version) as here:
        arm = here.arm
        await arm.line([(0.42, 0.05, 0.12, math.pi, 0, 0)], 0.1, 0.5, 0.8)
        first = arm.state.pose
        await arm.turn(0.5, 0.5, 1.0)
        second = arm.state.pose
        await arm.line([BEGIN], 0.2, 0.5, 0.8)  # a line after a velocity
        assert arm.state.stands_at(BEGIN)
        assert not arm.fault
    np.testing.assert_allclose(first, (0.42, 0.05, 0.12, math.pi, 0, 0), atol=6e-4)
    np.testing.assert_allclose(second[:3], first[:3], atol=6e-4)
    assert abs(second[4]) > 0.1  # turned about the vertical


@real
async def test_it_stops_though_its_controller_reads_commands_slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    step, turns = Program.step, count()

    def seldom(program: Program) -> bool:
        return step(program) if next(turns) % 25 == 0 else True  # every 0.2 s; writes come every 0.05 s

    async with lab() as here:
        monkeypatch.setattr(Program, "step", seldom)
        await here.arm.turn(0.4, 1.0, 1.0)
        assert here.arm.state.still
        assert abs(here.arm.state.pose[4]) > 0.2
        monkeypatch.undo()


@pytest.mark.virtual
async def test_it_follows_an_arc_at_its_height_to_its_end() -> None:
    radius, seen = 0.06, list[ArmState]()  # m
    angles = np.linspace(0.0, 0.5, 20).tolist()
    points = [(0.4, 0.06 - radius * math.cos(a), 0.1 + radius * math.sin(a), *BEGIN[3:]) for a in angles]
    async with lab() as here:
        moving = asyncio.create_task(here.arm.line(points[1:], 0.05, 0.5, 0.7))
        while not moving.done():
            seen.append(here.arm.state)
            await asyncio.sleep(0.008)
        await moving
        assert here.arm.state.still
        await here.arm.line([BEGIN], 0.2, 0.5, 0.5)  # a line after it
    off = [math.dist(state.pose[1:3], (0.06, 0.1)) - radius for state in seen]
    assert max(map(abs, off)) < 1e-3
    assert math.dist(seen[-1].pose[:3], points[-1][:3]) < 5e-3
    assert all(state.pose[3:] == pytest.approx(BEGIN[3:]) for state in seen)


def push(here: Lab) -> None:
    here.controller.box.drive.pose[0] += 1.2 * PATH_TOLERANCE


def narrow(here: Lab) -> None:
    here.arm.bounds = Bounds((0.3, -0.1, 0.05), (0.5, 0.02, 0.2))


def stop(here: Lab) -> None:
    here.controller.box.stop_for(SafetyMode.PROTECTIVE_STOP)


def to(*y: float, x: float = 0.4) -> Callable[[UrArm], Coroutine[Any, Any, None]]:
    return lambda arm: arm.line([(x, each, 0.1, *BEGIN[3:]) for each in y], 0.05, 0.5, 2.0)


@pytest.mark.virtual
@pytest.mark.parametrize(
    ("act", "move", "fault", "farthest"),
    [
        (push, to(0.02, 0.04), r"it is 6\.0 mm off its path", 0.03),
        (stop, away, "protective stop", 1e-6),
        (narrow, to(0.09), "at y 0.0.* m it is outside its workspace", 0.05),
        (None, to(0.0, x=0.6), ".*", 1e-6),
    ],
    ids=["path", "safety", "bounds", "target"],
)
async def test_it_is_stopped_for_good(
    act: Callable[[Lab], None] | None,
    move: Callable[[UrArm], Coroutine[Any, Any, None]],
    fault: str,
    farthest: float,
) -> None:
    here = await refused(act, move)
    assert re.fullmatch(fault, here.arm.fault)
    assert math.dist(here.arm.state.pose[:3], BEGIN[:3]) < farthest


@real
async def test_a_process_that_dies_leaves_no_arm_moving() -> None:
    def kill(here: Lab) -> None:
        process = here.arm.control.process
        assert process
        assert process.pid
        os.kill(process.pid, signal.SIGSEGV)

    here = await refused(kill, away)
    assert "died" in here.arm.fault
    assert here.controller.box.runtime_state == RuntimeState.STOPPED


@pytest.mark.virtual
async def test_a_missing_state_stops_it() -> None:
    async with lab() as here:
        asyncio.get_running_loop().call_later(0.3, here.controller.stall)
        with pytest.raises(EndpointError, match="its state is unknown: sent nothing"):
            await away(here.arm)
        assert "sent nothing" in here.arm.fault


@pytest.mark.virtual
@pytest.mark.parametrize(
    ("seconds", "reason"), [(-1.5, "to reach the target"), (1.0, "planted")], ids=["late", "stopped"]
)
async def test_an_arm_on_a_path_gets_no_velocity_after_the_stop(
    monkeypatch: pytest.MonkeyPatch, seconds: float, reason: str
) -> None:
    sent, arm = list[Command](), UrArm(HOST, BOUNDS, LoopClock())
    arm.state = ArmState(BEGIN, (0.0,) * 6)
    monkeypatch.setattr(arm.control, "send", sent.append)
    asyncio.get_running_loop().call_later(_STEERING, arm.fail, "planted")  # when the next velocity is due
    with pytest.raises(EndpointError, match=reason):
        await arm.line([BEGIN, (0.42, *BEGIN[1:])], 0.05, 0.5, seconds)
    assert sent.index(Signal.STOP) == len(sent) - 1


@pytest.mark.virtual
@pytest.mark.parametrize("move", [away, to(0.09), to(0.05, 0.09)], ids=["turn", "line", "path"])
async def test_a_cancelled_move_stops_the_arm(move: Callable[[UrArm], Coroutine[Any, Any, None]]) -> None:
    async with lab() as here:
        moving = asyncio.create_task(move(here.arm))
        await here.arm.wait(0.5)
        assert max(map(abs, here.arm.state.velocity)) > 0.01
        moving.cancel()
        await asyncio.gather(moving, return_exceptions=True)
        await here.arm.wait(1.0)
        assert here.arm.state.still
        assert not here.arm.fault


@pytest.mark.virtual
async def test_a_speed_slider_that_slows_the_arm_is_named(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(ControlBox, "slider", 0.5)
    async with lab():
        assert "its speed slider is at 50%, so that it moves slower than planned" in caplog.text


async def test_an_arm_that_may_not_move_is_not_opened() -> None:
    async with UrController(np.array(BEGIN), host=HOST, version=CB3) as controller:
        controller.box.stop_for(SafetyMode.ROBOT_EMERGENCY_STOP)
        with pytest.raises(EndpointError, match="emergency stop"):
            async with UrArm(HOST, BOUNDS, LoopClock()):
                pass


@pytest.mark.virtual
async def test_it_is_stopped_when_the_check_of_its_states_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> str:
        raise KeyError("planted")

    async with lab() as here:
        asyncio.get_running_loop().call_later(0.3, monkeypatch.setattr, Bounds, "violation", fail)
        with pytest.raises(EndpointError, match="the reading of its state has failed: KeyError"):
            await away(here.arm)
        await asyncio.sleep(2.0)
        assert np.abs(here.controller.box.drive.velocity).max() < 1e-3


async def test_the_dashboard_stops_the_program_of_an_arm() -> None:
    async with UrController(np.array(BEGIN), host=HOST, ports=ANYWHERE) as controller:
        controller.box.run_script("def program():\n  x = read_input_integer_reg(0)")
        assert await request_stop(HOST, controller.ports.dashboard) == "Stopped"
        assert controller.box.runtime_state == RuntimeState.STOPPED


@pytest.mark.parametrize(
    ("sent", "reason"), [(b"", "closed the connection without an answer"), (bytes(1 << 17), "Separator")]
)
async def test_an_answer_that_is_no_line_of_a_dashboard_is_an_error(sent: bytes, reason: str) -> None:
    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(sent)
        writer.close()

    async with await asyncio.start_server(serve, HOST, 0) as server:
        with pytest.raises(ValueError, match=reason):
            await request_stop(HOST, server.sockets[0].getsockname()[1])

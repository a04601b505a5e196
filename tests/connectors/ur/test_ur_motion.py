import asyncio
import logging
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass
from math import inf, nan
from typing import Any, cast

import numpy as np
import pytest

from connectors import UrMotion
from connectors.ur import rtde
from connectors.ur.rtde import Kind
from flows.graph import Flow
from flows.graph.testing import TestSink, VirtualLoop
from flows.run.clocks import LoopClock
from flows.run.diagnosis import diagnose
from flows.run.live_runner import LiveRunner
from operators import DeviceClock, EndpointError, Finding, Motion, concat, ms, s
from tests.emulators.ur_control_box import SafetyMode
from tests.emulators.ur_controller import ANYWHERE, CB3, E_SERIES, UrController

pytestmark = pytest.mark.virtual

HOST = "127.0.0.1"
FORWARD = np.array([0.1, -0.02, 0.0, 0.0, 0.0, 0.3])  # m/s, rad/s
POSE = np.array([0.4, 0.1, 0.2, 0.0, 0.0, 0.5])  # m, rad


@dataclass
class Lab:
    """Controller on the event loop's time, and a source that reads it."""

    controller: UrController
    source: UrMotion
    clock: LoopClock

    async def take(self, rows: int) -> Motion:
        """Return so many rows of a new connection."""
        taken = list[Motion]()
        async with aclosing(cast("Any", self.source.batches(self.clock))) as batches:
            async for batch in batches:
                taken.append(batch)
                if sum(map(len, taken)) >= rows:
                    break
        return concat(Motion, taken)

    async def fail(self, after: float, fault: Callable[[], None]) -> tuple[list[Motion], str]:
        """Return all batches of a connection with a fault `after` (s), and the reason for its end."""
        asyncio.get_running_loop().call_later(after, fault)
        taken = list[Motion]()
        try:
            async for batch in self.source.batches(self.clock):
                taken.append(batch)
        except EndpointError as error:
            return taken, str(error).removeprefix(f"rtde://{HOST}:{self.controller.ports.rtde}: ")
        raise AssertionError("it ended")


@asynccontextmanager
async def lab(
    version: tuple[int, ...] = E_SERIES, rate: float = 125.0, drift: float = 0.0
) -> AsyncGenerator[Lab]:
    clock = LoopClock(1_700_000_000 * s)
    async with UrController(
        POSE, host=HOST, ports=ANYWHERE, version=version, now=clock.now, drift=drift
    ) as controller:
        controller.box.drive.velocity = FORWARD
        yield Lab(controller, UrMotion(HOST, rate, controller.ports.rtde), clock)


@pytest.mark.parametrize(("version", "rate"), [(CB3, 125.0), (E_SERIES, 125.0), (E_SERIES, 500.0)])
async def test_every_package_is_received_once_in_order(version: tuple[int, ...], rate: float) -> None:
    async with lab(version, rate) as here:
        motion, about = await here.take(1000), here.source.describe()
    assert (np.diff(motion.device_time) == round(s / rate)).all()
    assert (motion.time - motion.device_time == 1_700_000_000 * s).all()  # no network delay
    travelled = motion.device_time[:, None] / s * FORWARD  # (n, 6)
    np.testing.assert_allclose(motion.pose, POSE + travelled, atol=1e-9)
    np.testing.assert_allclose(motion.velocity, np.tile(FORWARD, (len(motion), 1)))
    assert about["controller"] == ".".join(map(str, version))


async def test_a_slow_flow_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rtde, "BACKLOG", 20)
    taken = list[Motion]()
    async with lab() as here, aclosing(cast("Any", here.source.batches(here.clock))) as batches:
        async for batch in batches:
            taken.append(batch)
            await asyncio.sleep(2.0 if len(taken) % 10 == 0 else 0)
            if len(taken) > 60:
                break
    motion = concat(Motion, taken)
    assert (np.diff(motion.device_time) == 8 * ms).all()
    assert len(motion) > 4 * 250
    assert [len(batch) for batch in taken].count(20) >= 5  # reading pauses after 20 unread packages


async def test_a_stall_of_the_host_loses_nothing() -> None:
    async with lab() as here:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.call_later(1.0, loop.stall, 5.0)
        motion = await here.take(1000)
    assert (np.diff(motion.device_time) == 8 * ms).all()


async def test_a_clock_that_goes_back_ends_the_connection() -> None:
    async with lab() as here:
        taken, reason = await here.fail(1.0, lambda: here.controller.restart(drop=False))
        before, after = concat(Motion, taken), await here.take(5)
    assert (np.diff(before.device_time) == 8 * ms).all()
    assert len(before) in (124, 125)
    assert reason == "its clock went back: the controller restarted"
    assert after.device_time[0] < before.device_time[-1]


@pytest.mark.parametrize("stamp", [nan, inf, -1.0, 1e300])
async def test_invalid_stamps_are_refused(stamp: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.emulators.ur_control_box.ControlBox.timestamp", stamp)
    async with lab() as here:
        assert "sent timestamps" in (await here.fail(0.0, lambda: None))[1]


async def live(body: Callable[[Lab], None], seconds: int) -> tuple[Any, TestSink, Lab]:
    """Run the source, raw and in the host's time, with faults that `body` schedules."""
    async with lab(CB3, drift=50e-6) as here:
        flow, sink = Flow("arm"), TestSink()
        motion = flow.source(here.source)
        (motion | DeviceClock()).to(sink)
        body(here)
        run = await LiveRunner(flow, "run", clock=here.clock, duration=seconds * s).execute()
        return run, sink, here


async def test_after_a_restart_a_run_has_a_gap_and_a_new_epoch(caplog: pytest.LogCaptureFixture) -> None:
    def restart(here: Lab) -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(16.0, here.controller.restart)
        for time in (1.0, 2.0, 20.0):
            loop.call_later(time, lambda: here.controller.clients[-1].send(Kind.TEXT, b"\2hi\4RTDE\1"))

    with caplog.at_level(logging.INFO, "slipflow"):
        run, sink, here = await live(restart, 22)
    [gap] = run.sources["motion"].gaps
    assert 0 < gap.end - gap.start < 0.3 * s
    events = "controller", "controller", "motion failed, retrying", "motion works again", "controller"
    assert tuple(record.message.split(":")[0] for record in caplog.records) == events
    motion = sink.rows(Motion)
    [again] = np.flatnonzero(np.diff(motion.device_time) < 0) + 1
    for first in (0, again):
        stop = again if first == 0 else len(motion)
        began = motion.time[first] - motion.device_time[first]
        shown = motion.time[first:stop] - began - motion.device_time[first:stop] / (1 + 50e-6)
        assert np.abs(shown).max() < 0.3 * ms  # until the drift is known, after 5 s
    assert here.source.describe()["messages"] == 3


async def test_controller_and_rate_are_checked() -> None:
    async def found(version: tuple[int, ...], rate: float) -> list[Finding]:
        async with lab(version, rate) as here:
            return (await diagnose({"motion": here.source}, here.clock))["motion"]

    assert [(each.text, each.state) for each in await found(E_SERIES, 500.0)] == [
        ("controller of version 5.11.0.1", "good"),
        ("500.0 rows per second of 500", "good"),
    ]
    [slow] = await found(CB3, 100.0)
    assert (slow.state, "sends 125.0 Hz at most" in slow.text) == ("bad", True)


async def test_a_malformed_host_is_an_error_of_the_endpoint() -> None:
    [found] = (await diagnose({"motion": UrMotion("10..0.2")}, LoopClock()))["motion"]
    assert found == Finding("rtde://10..0.2:30004", "is not a valid name of a host", "bad")


async def test_an_arm_that_cannot_move_or_is_slow_is_noted() -> None:
    async with lab() as here:
        here.controller.box.safety_mode = SafetyMode.PROTECTIVE_STOP
        here.controller.box.slider = 0.5
        _, stopped, slow, _ = (await diagnose({"motion": here.source}, here.clock))["motion"]
    assert (stopped.text, stopped.state) == ("protective stop: see the teach pendant", "note")
    assert (slow.text.startswith("its speed slider is at 50%, "), slow.state) == (True, "note")

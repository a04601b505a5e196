import asyncio
import logging
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import pairwise
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from connectors import Gripper
from connectors.gripper.robotiq import Request
from flows.run.clocks import LoopClock
from flows.run.diagnosis import diagnose
from operators import EndpointError, s
from operators.batch import Commands
from operators.ports import Run
from tests.emulators.gripper import HOST, PORT, RELEASED, GripperServer, asked, register_force

pytestmark = pytest.mark.virtual
pytest.importorskip("pymodbus")


@dataclass
class Lab:
    """Emulated gripper on the event loop's time, and the requests that it received."""

    server: GripperServer
    run: Run
    asked: list[tuple[float, bytes]]  # s of the loop, and a request's bytes after the transaction's number
    answered: list[bytes]  # the same

    @asynccontextmanager
    async def gripping(self, force: float | None = None, **parameters: Any) -> AsyncGenerator[Gripper]:
        """Open a sink for a block, and command a force (N) if one is given."""
        gripper = Gripper(HOST, PORT, **parameters)
        await gripper.open(self.run)
        if force is not None:
            await gripper.write(commands(force))
        try:
            yield gripper
        finally:
            await gripper.close()

    @property
    def writes(self) -> list[Request]:
        """Requests to the gripper."""
        return [asked(data[-6:]) for _, data in self.asked if data[5] == 16]

    @property
    def forces(self) -> list[float]:
        """Grip forces on the object, N."""
        return self.server.mechanism.forces


@asynccontextmanager
async def lab(**parameters: Any) -> AsyncGenerator[Lab]:
    """Serve a gripper for a block."""
    loop, received, answered = asyncio.get_running_loop(), list[tuple[float, bytes]](), list[bytes]()
    begun = loop.time()
    server = GripperServer(now=lambda: round((loop.time() - begun) * s), **parameters)

    def listen(sending: bool, data: bytes) -> bytes:
        if sending:
            answered.append(data[2:])
        elif data:
            received.append((loop.time(), data[2:]))
        return data

    server.trace = listen
    async with server:
        yield Lab(server, Run("run1", "live", LoopClock(), 0), received, answered)


def commands(*forces: float) -> Commands:
    """Return a row for each force (N), 1 ns apart."""
    return Commands(np.arange(len(forces)), np.array(forces, float)).check()


async def test_requests_and_answers_equal_the_frames_in_the_manual() -> None:
    async with lab(contact=188) as at:
        async with at.gripping(force=60.0):
            await asyncio.sleep(5)
        looked = {data for _, data in at.asked if data[5] == 4}
        assert looked == {bytes.fromhex("00 00 00 06 02 04 00 00 00 08")}
        activate, close = [data for _, data in at.asked if data[5] == 16]
        assert activate == bytes.fromhex("00 00 00 0D 02 10 00 00 00 03 06 01 00 00 00 00 00")
        assert close == bytes.fromhex("00 00 00 0D 02 10 00 00 00 03 06 09 00 00 FF FF FF")
    written = {data for data in at.answered if data[5] == 16}
    assert written == {bytes.fromhex("00 00 00 06 02 10 00 00 00 03")}
    begun, ready, *_, gripped = dict.fromkeys(data for data in at.answered if data[5] == 4 and data[7])
    assert [begun[7:9].hex(), ready[7:9].hex()] == ["1100", "3100"]
    end = "00 00 00 13 02 04 10 B9 EA 00 FF BC 00 00 BC 00 00 BC 00 00 89 00 00"
    assert gripped.hex(" ").upper() == end


async def test_a_ready_gripper_keeps_its_object() -> None:
    async with lab() as at:
        for force in (20.0, None, 30.0):
            async with at.gripping(force):
                await asyncio.sleep(10)
        assert at.forces == [register_force(28), register_force(85)]
        assert len(at.writes) == 3


async def test_requests_are_paced_and_the_newest_force_is_sent() -> None:
    async with lab() as at, at.gripping(force=15.0) as gripper:
        await asyncio.sleep(5.05)  # between two looks
        begun = asyncio.get_running_loop().time()
        for register in range(1, 250):  # one each ms
            await gripper.write(commands(register_force(register)))
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.02)
        instants = [instant for instant, _ in at.asked]
        assert min(after - before for before, after in pairwise(instants)) >= 0.005 - 1e-9
        sent = [each.force for each in at.writes[2:] if each.force is not None]
        assert sent == sorted(set(sent))
        assert (len(sent) > 20, sent[-1]) == (True, 249)
        written = [instant - begun for instant, data in at.asked if data[5] == 16][2:]
        newest = [min(249, 1 + round(instant * 1000)) for instant in written]  # when each was sent
        assert all(fresh - force <= 1 for fresh, force in zip(newest, sent, strict=True))
        assert at.forces[-1] == register_force(249)


async def test_forces_are_clipped_and_rows_without_one_have_no_effect() -> None:
    async with lab() as at, at.gripping() as gripper:
        for force in (5.0, 61.0, nan, 30.0, -inf, inf):
            await gripper.write(commands(force, nan))
            await gripper.write(commands())
            await asyncio.sleep(0.1)
        assert [each.force for each in at.writes[1:]] == [0, 255, 85, 0, 255]


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("silent", r"modbus://.*/2: does not answer .*: is 2 its unit"),
        ("refusing", "refuses: device failure"),
    ],
)
async def test_a_gripper_that_fails_gets_the_newest_force_later(fault: str, reason: str) -> None:
    async with lab() as at, at.gripping(force=15.0) as gripper:
        await asyncio.sleep(5)
        setattr(at.server, fault, True)
        await asyncio.sleep(1.2)
        for force in (20.0, 25.0, 30.0):
            with pytest.raises(EndpointError, match=reason):
                await gripper.write(commands(force))
        assert gripper.status is None
        setattr(at.server, fault, False)
        await asyncio.sleep(4)
        assert [each.force for each in at.writes[2:]] == [85]
        assert at.forces == [15.0, register_force(85)]
        await gripper.write(commands(30.0))


async def test_a_fault_is_reset_at_the_start_of_a_run_only() -> None:
    async with lab() as at:
        gripper = Gripper(HOST, PORT)
        await gripper.open(at.run)
        await gripper.write(commands(20.0))
        await asyncio.sleep(5)
        at.server.mechanism.fail(RELEASED)
        await asyncio.sleep(1)
        with pytest.raises(EndpointError, match="has released automatically, and must be reset"):
            await gripper.write(commands(30.0))
        await asyncio.sleep(60)
        assert len(at.writes) == 2
        with pytest.raises(EndpointError, match="must be reset"):
            await gripper.close()
        await gripper.open(at.run)
        await gripper.write(commands(20.0))
        await asyncio.sleep(5)
        assert at.writes[2:4] == [Request(), Request(active=True)]
        assert at.forces == [register_force(28), 0.0, register_force(28)]
        await gripper.close()


async def test_closing_sends_the_newest_force_or_raises() -> None:
    async with lab() as at:
        gripper = Gripper(HOST, PORT)
        await gripper.open(at.run)
        await gripper.write(commands(20.0))
        await gripper.close()
        assert at.writes[-1].force == 28
        await gripper.open(at.run)
        at.server.restart(drop=False)
        await asyncio.sleep(0.2)
        await gripper.write(commands(30.0))
        with pytest.raises(EndpointError, match="is not ready for the newest command"):
            await gripper.close()
        await gripper.close()  # nothing is left to be done


async def test_the_check_before_a_run_reads_the_status_and_moves_nothing() -> None:
    async with lab() as at:
        clock = at.run.clock
        states = [(await diagnose({"hand": Gripper(HOST, PORT)}, clock))["hand"][0]]
        async with at.gripping():
            await asyncio.sleep(10)
        states += (await diagnose({"hand": Gripper(HOST, PORT)}, clock))["hand"]
        at.server.mechanism.fail(RELEASED)
        states += (await diagnose({"hand": Gripper(HOST, PORT)}, clock))["hand"]
        assert [found.state for found in states] == ["note", "good", "bad"]
        assert states[2].text.startswith("has released automatically, and must be reset: remove what")
        assert len(at.writes) == 1  # by the run
    [silent] = (await diagnose({"hand": Gripper("127.0.0.1", 1)}, clock))["hand"]
    assert (silent.state, silent.text.startswith("cannot be reached: is it on")) == ("bad", True)


async def test_a_failure_of_the_control_is_logged_at_once_and_raised_by_write_and_close(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_: Gripper) -> None:
        raise KeyError("planted")

    async with lab() as at:
        gripper = Gripper(HOST, PORT)
        await gripper.open(at.run)
        monkeypatch.setattr(Gripper, "_step", fail)
        await asyncio.sleep(1.0)
        assert "the control of the gripper has failed: KeyError: 'planted'" in caplog.text
        with pytest.raises(EndpointError, match="the control of the gripper has failed"):
            await gripper.write(commands(30.0))
        with pytest.raises(EndpointError, match="the control of the gripper has failed"):
            await gripper.close()


@pytest.mark.parametrize("drop", [False, True])
async def test_a_gripper_that_restarts_is_activated_again_and_grips_again(
    *, drop: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async with lab() as at, at.gripping(force=30.0) as gripper:
        await asyncio.sleep(5)
        at.server.restart(drop=drop)
        await asyncio.sleep(10)
        await gripper.write(commands(40.0))
        await asyncio.sleep(1)
        assert at.forces == [register_force(85), 0.0, register_force(85), register_force(141)]
    logged = [each.message.split(" ", 1)[1] for each in caplog.records if each.levelno >= logging.WARNING]
    assert logged == ["has restarted: activating it again"]


async def test_an_activation_that_takes_too_long_fails() -> None:
    async with lab(activation=3600.0) as at:
        loop = asyncio.get_running_loop()
        gripper, begun = Gripper(HOST, PORT), loop.time()
        with pytest.raises(EndpointError, match=r"is not ready within 30.0 s"):
            await gripper.open(at.run)
        assert 30 < loop.time() - begun < 30.5

"""The real client of pymodbus, and bytes on real sockets, against the emulated gripper."""

import asyncio
import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, closing
from typing import Any

import numpy as np
import pytest

from connectors import Gripper
from connectors.gripper.robotiq import Fingers, Phase, Request, Status, octets, registers
from flows.run.clocks import LoopClock
from operators import EndpointError, ParameterError, s
from operators.batch import Commands
from operators.ports import Run
from tests.connectors.emulators.faulty_gripper import FaultyGripperServer
from tests.connectors.emulators.observed_scene import ObservedScene
from tests.waiting import PATIENCE

pytest.importorskip("pymodbus")

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

HOST = "127.0.0.1"
CLOSE = Request(active=True, go=True, position=255, speed=255, force=255)


class Hand:
    """Clock that a test advances, and the force of the grip."""

    def __init__(self) -> None:
        self.time, self.forces = 1_000 * s, list[float]()

    def now(self) -> int:
        return self.time

    def command(self, commands: Commands) -> None:
        self.forces += commands.force.tolist()


@asynccontextmanager
async def served(**parameters: Any) -> AsyncGenerator[tuple[FaultyGripperServer, Hand]]:  # noqa: ANN401 - the server's
    hand = Hand()
    server = FaultyGripperServer(hand, port=0, now=hand.now, **parameters)
    async with asyncio.timeout(PATIENCE), server:
        yield server, hand


@asynccontextmanager
async def client(server: FaultyGripperServer, **parameters: Any) -> AsyncGenerator[AsyncModbusTcpClient]:  # noqa: ANN401
    modbus = AsyncModbusTcpClient(HOST, port=server.port, retries=0, reconnect_delay=0, **parameters)
    assert await modbus.connect()
    try:
        yield modbus
    finally:
        modbus.close()
        await asyncio.sleep(0)


async def ask(modbus: AsyncModbusTcpClient, request: Request, unit: int = 2) -> None:
    answer = await modbus.write_registers(0, registers(request.encode()), device_id=unit)
    assert not answer.isError()


async def look(modbus: AsyncModbusTcpClient, unit: int = 2) -> Status:
    answer = await modbus.read_input_registers(0, count=8, device_id=unit)
    return Status.decode(octets(answer.registers))


def test_it_answers_the_manuals_frames_byte_for_byte() -> None:
    async def test() -> None:
        async with served(activation=10.0, contact=188) as (server, hand):
            reader, writer = await asyncio.open_connection(HOST, server.port)
            with closing(writer):

                async def exchange(frame: str, length: int) -> str:
                    writer.write(bytes.fromhex(frame))
                    return (await reader.readexactly(length)).hex(" ").upper()

                activate = "33 9A 00 00 00 0D 02 10 00 00 00 03 06 01 00 00 00 00 00"
                assert await exchange(activate, 12) == "33 9A 00 00 00 06 02 10 00 00 00 03"
                hand.time += 5 * s
                first = "45 33 00 00 00 06 02 04 00 00 00 01"
                assert await exchange(first, 11) == "45 33 00 00 00 05 02 04 02 11 00"
                hand.time += 10 * s
                assert await exchange(first, 11) == "45 33 00 00 00 05 02 04 02 31 00"
                close = "71 EE 00 00 00 0D 02 10 00 00 00 03 06 09 00 00 FF FF FF"
                assert await exchange(close, 12) == "71 EE 00 00 00 06 02 10 00 00 00 03"
                hand.time += 10 * s
                status = await exchange("07 6B 00 00 00 06 02 04 00 00 00 08", 25)
                assert status == "07 6B 00 00 00 13 02 04 10 B9 EA 00 FF BC 00 00 BC 00 00 BC 00 00 89 00 00"
                assert hand.forces == [60.0]

    asyncio.run(test())


def test_the_real_client_activates_grips_and_lets_go() -> None:
    async def test() -> None:
        async with served(unit=9) as (server, hand), client(server) as modbus:
            assert await look(modbus, 9) == Status()
            await ask(modbus, Request(active=True), 9)
            hand.time += 3 * s
            assert (await look(modbus, 9)).phase is Phase.READY
            await ask(modbus, CLOSE, 9)
            hand.time += 3 * s
            status = await look(modbus, 9)
            assert (status.fingers, status.positions[0], hand.forces) == (Fingers.ALL_STOPPED, 120, [60.0])
            await modbus.write_register(1, 0, device_id=9)  # function 6 is not among those it has
            assert (await look(modbus, 9)).echo == 255
            await modbus.write_registers(1, [0], device_id=9)  # the position alone
            hand.time += 3 * s
            status = await look(modbus, 9)
            assert (status.fingers, hand.forces) == (Fingers.ARRIVED, [60.0, 0.0])

    asyncio.run(test())


def test_what_it_does_not_have_is_refused() -> None:
    async def test() -> None:
        async with served() as (server, _), client(server) as modbus:
            codes = [
                (await modbus.read_holding_registers(0, device_id=2)).exception_code,
                (await modbus.read_input_registers(4, count=5, device_id=2)).exception_code,
                (await modbus.write_registers(7, [0, 0], device_id=2)).exception_code,
                (await modbus.read_input_registers(0, device_id=3)).exception_code,
            ]
            assert codes == [1, 2, 2, 0x0B]

    asyncio.run(test())


def test_as_unit_zero_it_answers_as_any() -> None:
    async def test() -> None:
        async with served(unit=0) as (server, _), client(server) as modbus:
            for unit in (0, 2, 9):
                assert await look(modbus, unit) == Status()

    asyncio.run(test())


def test_after_a_restart_its_registers_are_zeros() -> None:
    async def test() -> None:
        async with served() as (server, hand), client(server) as modbus:
            await ask(modbus, CLOSE)
            hand.time += 10 * s
            assert (await look(modbus)).object_detected
            server.restart(drop=False)
            assert await look(modbus) == Status()
            await modbus.write_registers(2, [0xFFFF], device_id=2)  # nothing of the old request is left
            hand.time += s
            assert await look(modbus) == Status()
            async with client(server, timeout=0.5) as other:
                server.restart()
                with pytest.raises(ModbusException):
                    await look(other)

    asyncio.run(test())


def test_it_can_refuse_and_be_silent() -> None:
    async def test() -> None:
        async with served() as (server, hand), client(server) as modbus:
            server.refusing = True
            answer = await modbus.write_registers(0, registers(CLOSE.encode()), device_id=2)
            assert answer.exception_code == 4
            server.refusing = False
            hand.time += s
            assert await look(modbus) == Status()
            server.silent = True
            async with client(server, timeout=0.5) as other:
                with pytest.raises(ModbusException, match="No response"):
                    await ask(other, CLOSE)
            server.silent = False
            hand.time += s
            assert (await look(modbus)).active

    asyncio.run(test())


def test_a_port_that_is_taken_is_said_to_be() -> None:
    async def test() -> None:
        with socket.socket() as other:
            other.bind((HOST, 0))
            other.listen()
            port = other.getsockname()[1]
            with pytest.raises(EndpointError, match=f"{HOST}:{port}: cannot listen"):
                await FaultyGripperServer(Hand(), port=port, now=int).__aenter__()

    asyncio.run(test())


def test_it_listens_on_loopback_only_and_again_after_it_was_closed() -> None:
    async def test() -> None:
        async with served() as (server, _):
            await server.__aexit__()
            with pytest.raises(ConnectionError):
                await asyncio.open_connection(HOST, server.port)
            await server.__aenter__()
            _, writer = await asyncio.open_connection(HOST, server.port)
            assert writer.get_extra_info("peername")[0] == HOST
            writer.close()

    asyncio.run(test())


def test_a_unit_that_cannot_be_is_refused() -> None:
    with pytest.raises(ParameterError, match="GripperServer: unit is 256"):
        FaultyGripperServer(Hand(), unit=256, now=int)


def test_the_grip_reaches_the_scene_and_its_fingertip_feels_it() -> None:
    async def test() -> None:
        lab, gripped = await asyncio.to_thread(ObservedScene), asyncio.Event()

        class Scene:
            def command(self, commands: Commands) -> None:
                lab.command(commands)
                gripped.set()

        server = FaultyGripperServer(Scene(), port=0, now=lab.now, activation=0.05, contact=3)
        async with asyncio.timeout(PATIENCE), server:
            gripper = Gripper(HOST, server.port)
            rest, _ = lab.touch(0, lab.now())
            await gripper.open(Run("run1", "live", LoopClock(), 0))
            await gripper.write(Commands(np.array([0]), np.array([30.0]), np.full((1, 6), np.nan)))
            await gripped.wait()
            await gripper.close()
        pressed, _ = lab.touch(0, lab.now() + 2 * s)
        assert (pressed - rest).min() < -20  # counts fall as pressure rises
        assert lab.truth().force[-1] == pytest.approx(gripper.scale.force(85))

    asyncio.run(test())

"""The real client of pymodbus, and the manual's bytes, against the emulated gripper."""

import asyncio

import pytest

pytest.importorskip("pymodbus")

from pymodbus.client import AsyncModbusTcpClient

from connectors.gripper.robotiq import Fingers, Phase, Request, Status
from operators import s
from operators.batch import Commands
from tests.emulators.gripper import GripperServer
from tests.waiting import PATIENCE

CLOSE = Request(active=True, go=True, position=255, speed=255, force=255)


class Hand:
    """Clock that a test advances, and the force of the grip."""

    def __init__(self) -> None:
        self.time, self.forces = 1_000 * s, list[float]()

    def now(self) -> int:
        return self.time

    def command(self, commands: Commands) -> None:
        self.forces += commands.force.tolist()


async def look(modbus: AsyncModbusTcpClient) -> Status:
    answer = await modbus.read_input_registers(0, count=8, device_id=9)
    return Status.decode(answer.registers)


def test_it_answers_the_frames_in_the_manual_byte_for_byte() -> None:
    async def main() -> None:
        hand = Hand()
        server = GripperServer(hand, now=hand.now, port=0, activation=10.0, contact=188)
        async with asyncio.timeout(PATIENCE), server:
            reader, writer = await asyncio.open_connection(server.host, server.port)

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
            writer.close()

    asyncio.run(main())


def test_the_client_of_pymodbus_activates_grips_lets_go_and_is_refused() -> None:
    async def main() -> None:
        hand = Hand()
        server = GripperServer(hand, now=hand.now, port=0, unit=9)
        async with asyncio.timeout(PATIENCE), server:
            modbus = AsyncModbusTcpClient(server.host, port=server.port, retries=0, reconnect_delay=0)
            assert await modbus.connect()
            assert await look(modbus) == Status()
            await modbus.write_registers(0, Request(active=True).encode(), device_id=9)
            hand.time += 3 * s
            assert (await look(modbus)).phase is Phase.READY
            await modbus.write_registers(0, CLOSE.encode(), device_id=9)
            hand.time += 3 * s
            status = await look(modbus)
            assert (status.fingers, status.positions[0], hand.forces) == (Fingers.ALL_STOPPED, 120, [60.0])
            await modbus.write_registers(1, [0], device_id=9)  # the position alone
            hand.time += 3 * s
            status = await look(modbus)
            assert (status.fingers, hand.forces) == (Fingers.ARRIVED, [60.0, 0.0])
            refused = [
                (await modbus.read_holding_registers(0, device_id=9)).exception_code,
                (await modbus.read_input_registers(4, count=5, device_id=9)).exception_code,
                (await modbus.read_input_registers(0, device_id=3)).exception_code,
            ]
            assert refused == [1, 2, 0x0B]
            modbus.close()
            await asyncio.sleep(0)

    asyncio.run(main())

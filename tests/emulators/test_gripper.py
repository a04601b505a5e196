"""The emulated gripper and the manual; the tests of the sink use the client of pymodbus."""

import asyncio

import pytest

pytest.importorskip("pymodbus")

from operators import s
from tests.emulators.gripper import GripperServer
from tests.waiting import PATIENCE


def test_it_answers_the_frames_in_the_manual_byte_for_byte() -> None:
    async def main() -> None:
        time = 1_000 * s
        server = GripperServer(now=lambda: time, port=0, activation=10.0, contact=188)
        async with asyncio.timeout(PATIENCE), server:
            reader, writer = await asyncio.open_connection(server.host, server.port)

            async def exchange(frame: str, length: int) -> str:
                writer.write(bytes.fromhex(frame))
                return (await reader.readexactly(length)).hex(" ").upper()

            activate = "33 9A 00 00 00 0D 02 10 00 00 00 03 06 01 00 00 00 00 00"
            assert await exchange(activate, 12) == "33 9A 00 00 00 06 02 10 00 00 00 03"
            time += 5 * s
            first = "45 33 00 00 00 06 02 04 00 00 00 01"
            assert await exchange(first, 11) == "45 33 00 00 00 05 02 04 02 11 00"
            time += 10 * s
            assert await exchange(first, 11) == "45 33 00 00 00 05 02 04 02 31 00"
            close = "71 EE 00 00 00 0D 02 10 00 00 00 03 06 09 00 00 FF FF FF"
            assert await exchange(close, 12) == "71 EE 00 00 00 06 02 10 00 00 00 03"
            time += 10 * s
            status = await exchange("07 6B 00 00 00 06 02 04 00 00 00 08", 25)
            assert status == "07 6B 00 00 00 13 02 04 10 B9 EA 00 FF BC 00 00 BC 00 00 BC 00 00 89 00 00"
            assert server.mechanism.forces == [60.0]
            writer.close()

    asyncio.run(main())

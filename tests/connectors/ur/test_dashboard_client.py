import asyncio

import numpy as np
import pytest

from connectors.ur import dashboard_client
from operators import EndpointError
from tests.emulators.free_arm import FreeArm
from tests.emulators.ur_controller import Ports, UrController
from tests.waiting import PATIENCE


def test_a_command_is_answered() -> None:
    async def main() -> str:
        async with UrController(FreeArm(np.zeros(6)), ports=Ports(0, 0, 0)) as controller:
            return await dashboard_client.request(
                "127.0.0.1", "safetystatus", port=controller.ports.dashboard
            )

    assert asyncio.run(main()) == "Safetystatus: NORMAL"


@pytest.mark.parametrize(
    ("silent", "why"), [(True, r"does not answer within 0\.05 s"), (False, "closed the connection")]
)
def test_a_silent_dashboard_is_an_error_after_the_timeout(silent: bool, why: str) -> None:  # noqa: FBT001
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if silent:
            await reader.read()  # until the client is gone
        writer.close()
        await writer.wait_closed()
        served.set()

    served = asyncio.Event()

    async def main() -> None:
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            try:
                await dashboard_client.request(
                    "127.0.0.1", "stop", port=port, timeout=0.05 if silent else PATIENCE
                )
            finally:
                await served.wait()

    with pytest.raises(EndpointError, match=why):
        asyncio.run(main())


def test_an_endless_line_is_an_error() -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(bytes(1 << 17))
        await reader.read()  # until the client is gone
        writer.close()

    async def main() -> None:
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            await dashboard_client.request("127.0.0.1", "stop", port=port, timeout=PATIENCE)

    with pytest.raises(EndpointError, match="sends a line without an end: is it a dashboard"):
        asyncio.run(main())


def test_a_missing_dashboard_is_an_error() -> None:
    with pytest.raises(EndpointError, match=r"dashboard://127\.0\.0\.1:1"):
        asyncio.run(dashboard_client.request("127.0.0.1", "stop", port=1))

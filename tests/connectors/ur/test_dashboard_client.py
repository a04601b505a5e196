import asyncio

import numpy as np
import pytest

from connectors.emulators.free_arm import FreeArm
from connectors.emulators.ur_controller import Ports, UrController
from connectors.ur import dashboard_client as ur_dashboard
from operators import EndpointError


def test_it_answers_as_a_controllers_does() -> None:
    async def main() -> str:
        async with UrController(FreeArm(np.zeros(6)), ports=Ports(0, 0, 0)) as controller:
            return await ur_dashboard.ask("127.0.0.1", "safetystatus", port=controller.ports.dashboard)

    assert asyncio.run(main()) == "Safetystatus: NORMAL"


@pytest.mark.parametrize(
    ("silent", "why"), [(True, r"does not answer for 0\.05 s"), (False, "closed the connection")]
)
def test_one_that_says_nothing_is_not_waited_for(silent: bool, why: str) -> None:  # noqa: FBT001
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
                await ur_dashboard.ask("127.0.0.1", "stop", port=port, patience=0.05)
            finally:
                await served.wait()

    with pytest.raises(EndpointError, match=why):
        asyncio.run(main())


def test_a_dashboard_that_nobody_serves_is_an_error() -> None:
    with pytest.raises(EndpointError, match=r"dashboard://127\.0\.0\.1:1"):
        asyncio.run(ur_dashboard.ask("127.0.0.1", "stop", port=1))

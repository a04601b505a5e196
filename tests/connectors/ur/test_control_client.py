import asyncio
import multiprocessing
from multiprocessing.context import SpawnContext
from unittest.mock import patch

import pytest

from connectors.ur.control_client import ControlClient


def test_a_process_that_cannot_be_started_leaves_no_pipe() -> None:
    async def main() -> None:
        client = ControlClient("robot", 5.0, lambda: None, lambda _reason: None)
        pipes = multiprocessing.Pipe()
        with (
            patch.object(SpawnContext, "Pipe", return_value=pipes),
            patch.object(SpawnContext.Process, "start", side_effect=OSError("out of memory")),
            pytest.raises(OSError, match="out of memory"),
        ):
            client.start()
        assert all(pipe.closed for pipe in pipes)
        assert client.process is None
        await client.close()

    asyncio.run(main())

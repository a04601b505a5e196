import asyncio
import select
import socket
from time import monotonic
from unittest.mock import patch

from connectors.punctual_loop import EARLY, PunctualSelector, run_punctually


def test_a_wait_is_not_rounded_and_does_not_end_early() -> None:
    async def main() -> float:
        began = monotonic()
        await asyncio.sleep(0.1005)
        return monotonic() - began

    with patch("select.select", wraps=select.select) as sleeping:
        waited = run_punctually(main())
    assert waited >= 0.1005
    assert 0 < sleeping.call_args_list[0].args[3] < 0.1005 - EARLY / 2


def test_input_ends_a_wait() -> None:
    async def main() -> bytes:
        mine, other = socket.socketpair()
        with mine, other:
            mine.setblocking(False)
            loop = asyncio.get_running_loop()
            loop.call_later(0.01, other.send, b"x")
            async with asyncio.timeout(60):
                return await loop.sock_recv(mine, 1)

    assert run_punctually(main()) == b"x"


def test_a_selector_without_input_returns_after_its_time() -> None:
    with PunctualSelector() as selector:
        for timeout in (0.0, EARLY / 2, 5 * EARLY):
            began = monotonic()
            assert selector.select(timeout) == []
            assert monotonic() - began >= timeout

"""Waiting for another thread, task or process."""

import asyncio
import subprocess
from collections.abc import Callable
from time import monotonic, sleep
from typing import Any, Final

PATIENCE: Final = 60.0  # s, deadline for a busy machine


async def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition becomes true in another thread, task or process.

    Raises:
        TimeoutError: after the deadline.
    """
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110 - no event to wait for
            await asyncio.sleep(0.01)


def wait_until(
    condition: Callable[[], object], process: subprocess.Popen[Any] | None = None, *, within: float = PATIENCE
) -> None:
    """Wait without an event loop; fail after the deadline, or when a process has ended."""
    deadline = monotonic() + within
    while not condition():
        assert process is None or process.poll() is None
        assert monotonic() < deadline
        sleep(0.01)

"""Waiting for another thread, task or process."""

import asyncio
from collections.abc import Callable
from typing import Final

PATIENCE: Final = 60.0  # s, deadline for a busy machine


async def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition becomes true in another thread, task or process.

    Raises:
        TimeoutError: after the deadline.
    """
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110 - no event to wait for
            await asyncio.sleep(0.01)

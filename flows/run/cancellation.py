"""Cancellation of a task, distinguished from that of a task that it awaits."""

import asyncio
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def own_cancellation() -> Generator[None]:
    """Pass on the cancellation of this task only; that of a task that the code awaits is a failure.

    Raises:
        RuntimeError: if the code raises CancelledError although this task was not cancelled.
    """
    try:
        yield
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        raise RuntimeError("a task that it awaited was cancelled") from error

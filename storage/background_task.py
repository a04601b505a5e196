"""Background task of a source, a sink or a device, whose failure does not go unnoticed."""

import asyncio
import logging
import traceback
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from operators.errors import EndpointError

log = logging.getLogger("slipflow")


class BackgroundTask:
    """Task that works until its owner ends it.

    A failure is an exception, a cancellation of something it awaits, or a return before `end`. It is logged
    at once. The owner calls `check` where the failure can end the run: in its next call, or after it is
    closed.

    Args:
        owner: Endpoint that the task belongs to, in messages.
        purpose: Work of the task, in messages.
        work: Coroutine of the task.
        on_failure: Called with the reason of a failure, after it was logged.
        endless: Whether the task may not return before `end`.

    Attributes:
        reason: Reason of the failure; empty: none.
        ending: Whether the task may return; `end` sets it.
    """

    def __init__(
        self,
        owner: str,
        purpose: str,
        work: Coroutine[Any, Any, None],
        on_failure: Callable[[str], object] = lambda _: None,
        *,
        endless: bool = True,
    ) -> None:
        self._owner, self._purpose, self._on_failure, self._endless = owner, purpose, on_failure, endless
        self.reason = ""
        self._cause: BaseException | None = None
        self.ending = False
        self._task = asyncio.create_task(work)
        self._task.add_done_callback(self._after)

    @property
    def done(self) -> bool:
        """True after the task has ended."""
        return self._task.done()

    def check(self) -> None:
        """Raise the failure of the task.

        Raises:
            EndpointError: if it has failed; its cause is the exception.
        """
        if self.reason:
            raise EndpointError(self._owner, self.reason) from self._cause

    async def end(self, timeout: float | None = 0.0) -> None:  # noqa: ASYNC109 - as asyncio.wait has it
        """Let the task return within `timeout` (s; None: without limit), then cancel it; raise no failure."""
        self.ending = True
        try:
            if timeout != 0 and not self._task.done():
                await asyncio.wait([self._task], timeout=timeout)
        finally:
            self._task.cancel()
            await asyncio.wait([self._task])

    def _after(self, task: asyncio.Task[None]) -> None:
        if task.cancelled():
            if not task.cancelling():
                self._fail("a task that it awaited was cancelled")
        elif error := task.exception():
            self._cause = error
            self._fail(f"{type(error).__name__}: {error}{_location(error)}")
        elif self._endless and not self.ending:
            self._fail("it ended early")

    def _fail(self, reason: str) -> None:
        self.reason = f"{self._purpose} has failed: {reason}"
        log.error("%s: %s", self._owner, self.reason)
        self._on_failure(self.reason)


def _location(error: BaseException) -> str:
    """Return the line that raised an error, such as `` (outbox.py:23)``."""
    frames = traceback.extract_tb(error.__traceback__)
    return f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""

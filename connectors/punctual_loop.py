"""Event loop that wakes up on time: asyncio's rounds each wait up to a whole millisecond."""

import asyncio
import select
import selectors
from collections.abc import Coroutine
from time import monotonic
from typing import Any, Final, TypeVar

EARLY: Final = 150e-6  # s before the end of a wait from which the process polls instead of sleeping

T = TypeVar("T")


class PunctualSelector(selectors.DefaultSelector):
    """Selector whose waits end within about 100 us of their time.

    The system wakes a process 50 to 150 us late. So it sleeps until `EARLY` before the end of the wait and
    then polls, which costs up to 100 us of CPU time per wait; see docs/explanations/performance.md.
    """

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for input, `timeout` s at most; None: for ever."""
        if timeout is None or timeout <= 0:
            return super().select(timeout)
        end = monotonic() + timeout
        if timeout > EARLY:  # `select` accepts fractions of a millisecond, and an epoll object
            select.select([self.fileno()], [], [], timeout - EARLY)
        while not (ready := super().select(0)) and monotonic() < end:
            pass
        return ready


def run_punctually(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine as `asyncio.run` does, in a loop with a `PunctualSelector`."""
    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(PunctualSelector())) as runner:
        return runner.run(main)

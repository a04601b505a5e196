"""Event loop for a virtual lab: a busy host makes its time slow, and the lab stays correct."""

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from math import inf
from time import monotonic, time_ns
from typing import Any, Final, TypeVar

from connectors.punctual_loop import PunctualSelector
from operators.batch import s

STEP: Final = 0.008  # s by which an iteration of the loop may exceed its planned wait; one cycle of a CB3
POLL: Final = 0.005  # s between checks of the condition for which time waits
PATIENCE: Final = 2000  # checks until time passes in spite of the condition, 10 s on an idle host

T = TypeVar("T")


class _SlowSelector(PunctualSelector):
    """Selector that measures the loop's time: the host's, without its stalls."""

    def __init__(self) -> None:
        super().__init__()
        now = monotonic()
        self._progress = now, now, STEP  # loop time and host time (s) of the newest step, and its limit (s)
        self._checks = 0
        self.held: Callable[[], bool] = lambda: False

    def time(self) -> float:
        """Return the loop's time, s; any thread may call this."""
        time, host, limit = self._progress
        return time + min(max(0.0, monotonic() - host), limit)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for input; begin an iteration of the loop, in which time advances by a limited step."""
        held = self.held()
        if not held:
            self._checks = 0
        elif held := self._checks < PATIENCE:
            timeout = POLL if timeout is None else min(timeout, POLL)
        limit = 0.0 if held else inf if timeout is None else max(0.0, timeout) + STEP
        host = monotonic()
        self._progress = self.time(), host, limit
        ready = super().select(timeout)
        self._checks += held and not ready
        return ready


class LabLoop(asyncio.SelectorEventLoop):
    """Event loop whose time advances with the host's, by at most `STEP` per iteration in addition to waits.

    After a stall of the host the loop is late, but its tasks, the emulated devices and their clients are late
    together: none has a jump in time.
    """

    def __init__(self) -> None:
        self._time_keeper = _SlowSelector()
        super().__init__(self._time_keeper)

    def time(self) -> float:
        """Return the loop's time, s."""
        return self._time_keeper.time()

    def hold_while(self, held: Callable[[], bool]) -> None:
        """Stop time whenever `held` is true, for at most `PATIENCE` checks; input is still handled."""
        self._time_keeper.held = held


def run_lab(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine in a `LabLoop`, as `asyncio.run` does in a common loop."""
    with asyncio.Runner(loop_factory=LabLoop) as runner:
        return runner.run(main)


def loop_clock() -> Callable[[], int]:
    """Return a clock (ns since 1970 UTC) that runs on the time of the event loop."""
    loop = asyncio.get_running_loop()
    start = time_ns() - round(loop.time() * s)
    return lambda: start + round(loop.time() * s)

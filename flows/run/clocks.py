"""The clocks of a run."""

import asyncio
import time

from operators.batch import ms, s

STEP = 10 * ms  # ns; the host's clock was set if it is further off than before


class LoopClock:
    """Time of the running event loop: monotonic, so a step of the host's clock changes no stamp.

    In a replay it starts at the recording's first stamp and may run faster or slower than real time.
    """

    def __init__(self, start: int | None = None, pace: float = 1.0) -> None:
        """Show `start` now (ns since 1970 UTC; default: what the host shows), then run at `pace`."""
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        self._start = time.time_ns() if start is None else start
        self._ahead = time.time_ns() - time.monotonic_ns() if start is None else None
        self._pace = pace

    @property
    def stray(self) -> int | None:
        """How far the host's clock is ahead of this one, ns: it was set since; None in a replay."""
        return None if self._ahead is None else time.time_ns() - time.monotonic_ns() - self._ahead

    def now(self) -> int:
        """The present, ns since 1970-01-01 UTC."""
        return self._start + round((self._loop.time() - self._began) * self._pace * s)

    async def sleep_until(self, time: int) -> None:
        """Wait until `time` (ns); at once if it has passed."""
        wait = (time - self.now()) / s / self._pace
        if wait > 0:
            await asyncio.sleep(wait)


class EventClock:
    """Time as told by the newest event: the clock of a replay at full speed."""

    def __init__(self, start: int) -> None:
        self.newest = start  # ns

    def now(self) -> int:
        """The newest event time, ns since 1970-01-01 UTC."""
        return self.newest

    async def sleep_until(self, time: int) -> None:
        """Go on at once, at `time` (ns)."""
        self.newest = max(self.newest, time)

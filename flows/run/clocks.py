"""Clocks of a run."""

import asyncio
import time

from operators.batch import ms, s

STEP = 10 * ms  # ns; least change of the host clock's offset that counts as a step


class LoopClock:
    """Clock of the running event loop: monotonic, so steps of the host's clock do not affect time stamps."""

    def __init__(self, start: int | None = None) -> None:
        """Start at `start` (ns; default: the host's time)."""
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        self._start = time.time_ns() if start is None else start
        self._ahead = _host_ahead()

    @property
    def host_offset(self) -> int:
        """Offset of the host's clock from this one, ns, due to steps since the start."""
        return _host_ahead() - self._ahead

    def now(self) -> int:
        """Return the current time, ns since 1970-01-01 UTC."""
        return self._start + round((self._loop.time() - self._began) * s)

    async def sleep_until(self, time: int) -> None:
        """Wait until `time` (ns); return at once if it has passed."""
        wait = (time - self.now()) / s
        if wait > 0:
            await asyncio.sleep(wait)


def _host_ahead() -> int:
    """Return the host's time minus its monotonic time (ns), both read without a suspension in between."""
    while True:
        before, now, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after - before < STEP // 10:
            return now - before


class EventClock:
    """Clock of a replay at full speed: the time of the newest event."""

    def __init__(self, start: int) -> None:
        self.newest = start  # ns

    def now(self) -> int:
        """Return the newest event time, ns since 1970-01-01 UTC."""
        return self.newest

    async def sleep_until(self, time: int) -> None:
        """Set the clock to `time` (ns) and return at once."""
        self.newest = max(self.newest, time)

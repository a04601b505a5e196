"""Thread that scans TakkTile fingertips on schedule and passes the scans to an event loop."""

import asyncio
import logging
from collections import deque
from collections.abc import AsyncGenerator, Callable
from errno import ENODEV, EREMOTEIO
from os import strerror
from threading import Event, Thread
from typing import Final

from connectors.takktile.scanner import Scan, Scanner, Schedule, i2c_reason
from operators.batch import ms, s
from operators.errors import EndpointError

log = logging.getLogger("slipflow")

LOST_AFTER: Final = 250 * ms  # ns without a sample, at least three scans
TIMEOUT: Final = 3.0  # s, for a scan and for the end of the thread
SHORTEST_WAIT: Final = ms // 5  # ns, between looks at a slow clock
BACKLOG: Final = 1000  # maximum of scans that wait for the event loop


class ScanThread:
    """Thread that scans until the sensor is lost or `end` is called; the running event loop reads the scans.

    Args:
        schedule: Schedule of the scans.
        now: Clock of the samples, ns.
    """

    def __init__(self, schedule: Schedule, now: Callable[[], int]) -> None:
        self._schedule, self._now, self._path = schedule, now, schedule.path
        self._loop = asyncio.get_running_loop()
        self._results = deque[Scan | BaseException]()  # scans, and the error after them
        self._changed, self._ending = asyncio.Event(), Event()
        self._thread = Thread(target=self._run, name=f"takktile {self._path}", daemon=True)
        self._thread.start()

    async def scans(self) -> AsyncGenerator[Scan]:
        """Yield the scans.

        Raises:
            EndpointError: if the sensor is lost or the bus hangs.
        """
        timeout = TIMEOUT + self._schedule.period / s
        while True:
            while self._results:
                result = self._results.popleft()
                if isinstance(result, BaseException):
                    raise result
                yield result
            self._changed.clear()
            try:
                async with asyncio.timeout(timeout):
                    await self._changed.wait()
            except TimeoutError:
                if not self._results:  # else the event loop was late, not the bus
                    reason = f"is blocked for {timeout:.0f} s: reset its adapter, or restart the machine"
                    raise EndpointError(self._path, reason) from None

    async def end(self) -> None:
        """Disconnect all cells, close the bus and end the thread; abandon the thread if it is blocked."""
        self._ending.set()
        await asyncio.to_thread(self._thread.join, TIMEOUT)
        if self._thread.is_alive():
            log.warning("%s: abandoned a blocked thread", self._path)

    def _run(self) -> None:
        scanner: Scanner | None = None
        try:
            scanner = Scanner(self._schedule, self._now)
            self._scan(scanner)
        except OSError as error:
            self._pass_on(EndpointError(self._path, i2c_reason(error)))
        except BaseException as error:  # noqa: BLE001 - no failure of the device: raised to the runner as it is
            self._pass_on(error)
        finally:
            if scanner is not None:
                scanner.close()

    def _scan(self, scanner: Scanner) -> None:
        """Scan on schedule.

        Raises:
            OSError: if the sensor is lost.
        """
        period, counted = self._schedule.period, self._schedule.counted
        sampled, answered = self._now(), False
        due = sampled
        while self._wait_until(due):
            if len(self._results) < BACKLOG:
                counted["late"] += self._now() - due > period // 10
                scan = scanner.scan()
                counted["made"] += 1
                if scan.valid.any():
                    sampled, answered = self._now(), True
                else:
                    counted["silent"] += 1
                    unplugged = scan.error is not None and scan.error.errno == ENODEV
                    if self._now() - sampled > max(LOST_AFTER, 3 * period) or unplugged:
                        raise scan.error or OSError(EREMOTEIO, strerror(EREMOTEIO))
                if answered:  # a sensor without any sample so far is still lost
                    self._pass_on(scan)
            else:
                counted["missed"] += 1
            due, missed = next_scan(due, self._now(), period)
            counted["missed"] += missed

    def _wait_until(self, due: int) -> bool:
        """Wait until `due` (ns) on the clock, which may be slow; return False when the thread must end."""
        while (wait := due - self._now()) > 0 and not self._ending.is_set():
            self._ending.wait(max(wait, SHORTEST_WAIT) / s)
        return not self._ending.is_set()

    def _pass_on(self, result: Scan | BaseException) -> None:
        self._results.append(result)
        try:
            self._loop.call_soon_threadsafe(self._changed.set)
        except RuntimeError:  # the loop is closed, so `end` will not be called
            self._ending.set()


def next_scan(due: int, now: int, period: int) -> tuple[int, int]:
    """Return when the scan after `due` is due, and the number of missed scans between them.

    A scan that can still begin within its own period is late, not missed.

    >>> next_scan(100, 105, 10), next_scan(100, 119, 10), next_scan(100, 137, 10)
    ((110, 0), (110, 0), (130, 2))
    """
    missed = max(0, now - due - period) // period
    return due + (1 + missed) * period, missed

"""The thread that scans TakkTile fingertips on schedule, and hands the scans to an event loop."""

import asyncio
import logging
from collections import deque
from collections.abc import AsyncGenerator, Callable, Sequence
from dataclasses import dataclass
from errno import ENODEV, EREMOTEIO
from os import strerror
from threading import Event, Thread
from time import monotonic_ns
from typing import Final

from connectors.takktile.i2c_access import I2cBus
from connectors.takktile.takktile_protocol import Coefficients
from connectors.takktile.takktile_scan import Scan, Scanner, reason
from operators.batch import ms, s
from operators.errors import EndpointError

log = logging.getLogger("slipflow")

PERSISTENCE: Final = 250 * ms  # without a reading, and three scans, after which the sensor is lost
PATIENCE: Final = 3.0  # s, for the thread to say something or to end
BACKLOG: Final = 1000  # scans that may wait for the event loop


@dataclass(frozen=True)
class Schedule:
    """What to scan, and when.

    Attributes:
        bus: The bus.
        rows: Of the fingertips.
        conversion: Wait for a conversion, ns.
        period: From scan to scan, ns.
        counted: Scans that were made, of these the ones in which nobody answered (silent) and that began
            more than a tenth of the period after they were due (late); and those that were missed.
    """

    bus: I2cBus
    rows: Sequence[int]
    conversion: int
    period: int
    counted: dict[str, int]


class ScanThread:
    """Scans a sensor until it is lost or the thread is told to end; for a task of the running event loop.

    Args:
        schedule: What to scan, and when.
        now: The clock to stamp with, ns.
        learn: Told of what each cell says of itself, as by `Scanner`.
    """

    def __init__(
        self,
        schedule: Schedule,
        now: Callable[[], int],
        learn: Callable[[int, int, Coefficients | None], None],
    ) -> None:
        self._schedule, self._now, self._learn = schedule, now, learn
        self._loop = asyncio.get_running_loop()
        self._scans = deque[Scan]()
        self._error: EndpointError | None = None
        self._news, self._ended = asyncio.Event(), asyncio.Event()
        self._ending, self._blocked = Event(), False
        self._thread = Thread(target=self._run, name=f"takktile {schedule.bus.path}", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether it has not ended yet."""
        return self._thread.is_alive()

    async def scans(self) -> AsyncGenerator[Scan]:
        """The scans, as they are made.

        Raises:
            EndpointError: when the sensor is lost, or nothing has been heard of the thread for long: the
                operating system has not come back to it.
        """
        patience = PATIENCE + self._schedule.period / s
        while True:
            error = self._error  # first: the scans before it count
            while self._scans:
                yield self._scans.popleft()
            if error is not None:
                raise error
            self._news.clear()
            try:
                async with asyncio.timeout(patience):
                    await self._news.wait()
            except TimeoutError:
                if not self._scans:
                    self._blocked = True
                    raise EndpointError(
                        self._schedule.bus.path, f"is blocked for {patience:.0f} s: reset its adapter"
                    ) from None

    async def end(self) -> None:
        """Have it disconnect all cells, close the bus and end; leave it behind if it is blocked."""
        self._ending.set()
        try:
            async with asyncio.timeout(0 if self._blocked else PATIENCE):
                await self._ended.wait()
            self._thread.join()  # saying so was the last thing it had to do
        except TimeoutError:
            log.warning("%s: left a thread behind that is blocked", self._schedule.bus.path)

    def _run(self) -> None:
        schedule, scanner = self._schedule, None
        try:
            scanner = Scanner(schedule.bus, schedule.rows, schedule.conversion, self._now, self._learn)
            self._scan(scanner)
        except OSError as error:
            self._error = EndpointError(schedule.bus.path, reason(error))
        except Exception as error:  # noqa: BLE001 - a thread that fails says so, whatever it is
            self._error = EndpointError(schedule.bus.path, f"{type(error).__name__}: {error}")
            self._error.__cause__ = error
        finally:
            self._tell(self._news)
            if scanner is not None:
                scanner.close()
            self._tell(self._ended)

    def _scan(self, scanner: Scanner) -> None:
        """Scan on schedule.

        Raises:
            OSError: when the sensor is lost.
        """
        period, counted = self._schedule.period, self._schedule.counted
        heard, answered = monotonic_ns(), False
        due = heard
        while not self._ending.wait(max(0, due - monotonic_ns()) / s):
            if len(self._scans) < BACKLOG:
                counted["late"] += monotonic_ns() - due > period // 10
                scan = scanner.scan()
                counted["made"] += 1
                if scan.valid.any():
                    heard, answered = monotonic_ns(), True
                else:
                    counted["silent"] += 1
                    if monotonic_ns() - heard > max(PERSISTENCE, 3 * period) or _gone(scan.error):
                        raise scan.error or OSError(EREMOTEIO, strerror(EREMOTEIO))
                if answered:  # a sensor that is silent from the start is not back
                    self._scans.append(scan)
                    self._tell(self._news)
            else:
                counted["missed"] += 1
            due, missed = following(due, monotonic_ns(), period)
            counted["missed"] += missed

    def _tell(self, event: asyncio.Event) -> None:
        try:
            self._loop.call_soon_threadsafe(event.set)
        except RuntimeError:  # the loop is closed: nobody will tell us to end
            self._ending.set()


def following(due: int, now: int, period: int) -> tuple[int, int]:
    """When the next scan is due, once one that was due at `due` is done, and how many have been missed.

    A scan that can still begin within its own period is late, and not missed.

    >>> following(100, 105, 10), following(100, 119, 10), following(100, 137, 10)
    ((110, 0), (110, 0), (130, 2))
    """
    missed = max(0, now - due - period) // period
    return due + (1 + missed) * period, missed


def _gone(error: OSError | None) -> bool:
    """Whether there is no point in trying again with what is open."""
    return error is not None and error.errno == ENODEV

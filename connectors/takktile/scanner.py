"""Scanner of TakkTile fingertips on an I2C bus, and the thread that runs it, because transfers block."""

import asyncio
import errno
import fcntl
import logging
from collections import deque
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import suppress
from threading import Event, Thread
from time import sleep
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from smbus2 import I2cFunc, SMBus

from connectors.takktile.takktile_protocol import (
    ALL,
    BAROMETER,
    COEFFICIENTS,
    CONVERT,
    DATA,
    Coefficients,
    OverloadDetector,
    Reading,
    cell_address,
)
from operators.batch import BAROMETERS, Counts, Flags, ms, s
from operators.errors import EndpointError, os_error_reason

Cells: TypeAlias = Mapping[int, list[Coefficients | None]]  # by row

log = logging.getLogger("slipflow")

CONVERSION: Final = 3 * ms  # ns, longest duration of a conversion; datasheet
READINGS: Final = 4  # of coefficients, until two in a row are equal
LOST_AFTER: Final = 250 * ms  # ns without a sample, at least three scans
TIMEOUT: Final = 3.0  # s, for a scan and for the end of the thread
SHORTEST_WAIT: Final = ms // 5  # ns, between looks at a slow clock
BACKLOG: Final = 1000  # maximum of scans that wait for the event loop
_NOT_ACKNOWLEDGED: Final = (errno.EREMOTEIO, errno.ENXIO)  # adapters differ
_IMPLAUSIBLE: Final = "no cell gives plausible values: unload the fingertips, or replace them"
_NO_ANSWER: Final = "no fingertip answers: check the power and the rows"
_REASONS: Final = {
    errno.ENOENT: "the bus does not exist: is I2C enabled?",
    errno.EACCES: "permission denied: is the user in the group i2c?",
    errno.EWOULDBLOCK: "is in use: end the other program or source, or reset a blocked adapter",
    errno.EBUSY: "a kernel driver uses the address of the barometers: unload it",
    errno.EREMOTEIO: _NO_ANSWER,
    errno.ENXIO: _NO_ANSWER,
    errno.ETIMEDOUT: "timeout: a device blocks the bus; switch the fingertips off and on",
    errno.ENOTTY: "is no I2C bus: give its number, or a path such as /dev/i2c-1",
    errno.ENODEV: "the adapter is missing: is it plugged in?",
}


class Scan(NamedTuple):
    """Samples of all cells of all fingertips, converted at the same time."""

    time: int  # ns, start of the conversion
    counts: Counts  # (fingertips, 6) raw; 0 if the cell did not answer
    temperature: Counts  # (fingertips, 6) raw; 0 if the cell did not answer
    valid: Flags  # (fingertips, 6) False: no answer, or an implausible reading
    error: OSError | None = None  # error that aborted the scan; then no sample is valid

    @classmethod
    def blank(cls, time: int, fingertips: int, error: OSError | None = None) -> "Scan":
        """Return a scan without samples."""
        counts, temperature = np.zeros((2, fingertips, BAROMETERS), np.int16)
        return cls(time, counts, temperature, np.zeros((fingertips, BAROMETERS), np.bool_), error)


def i2c_reason(error: OSError) -> str:
    """Return the reason of a bus error, with its likely cause or remedy."""
    text = _REASONS.get(error.errno or 0) or os_error_reason(error, of_device=True)
    return f"{text} (errno {error.errno})"


class Scanner:
    """Scanner of the fingertips on a bus, which it opens exclusively; all cells are then disconnected.

    A cell is read only while all others are confirmed to be disconnected: connected cells answer at the same
    time, and the result looks like data. After every error, a scan disconnects all cells.

    Args:
        path: Path of the bus, such as /dev/i2c-1.
        cells: Coefficients of the 6 cells of each fingertip, by its row, which the scanner fills; None: not
            read yet, or not plausible.
        now: Clock of the samples, ns.

    Raises:
        OSError: if the bus cannot be used, or no fingertip answers.
    """

    def __init__(self, path: str, cells: Cells, now: Callable[[], int]) -> None:
        self._rows, self._now = list(cells), now
        self._overload = [[OverloadDetector() for _ in range(BAROMETERS)] for _ in self._rows]
        self._bus = SMBus()
        try:
            self._bus.open(path)
            assert self._bus.fd is not None
            fcntl.flock(self._bus.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._quick = bool(self._bus.funcs & I2cFunc.SMBUS_QUICK)
            self._disconnect_all()
            for row, known in cells.items():
                known[:] = [self._read_coefficients(cell_address(row, cell)) for cell in range(BAROMETERS)]
        except BaseException:
            self._bus.close()
            raise

    def close(self) -> None:
        """Disconnect all cells, if possible, and close the bus."""
        with suppress(OSError):
            self._disconnect(ALL)
        with suppress(OSError):
            self._bus.close()

    def scan(self) -> Scan:
        """Convert all cells at the same time, then read them one by one; blocks for at least a conversion."""
        scan = Scan.blank(self._now(), len(self._rows))
        try:
            scan = scan._replace(time=self._convert())
            for fingertip, row in enumerate(self._rows):
                for cell in range(BAROMETERS):
                    data = self._read(cell_address(row, cell), DATA, 4)
                    reading = Reading.decode(data or bytes(4))  # 0 is implausible
                    scan.counts[fingertip, cell] = reading.pressure
                    scan.temperature[fingertip, cell] = reading.temperature
                    count = reading.pressure if reading.plausible else None
                    scan.valid[fingertip, cell] = self._overload[fingertip][cell].valid(count)
        except OSError as error:
            with suppress(OSError):
                self._disconnect_all()
            return Scan.blank(scan.time, len(self._rows), error)
        return scan

    def _convert(self) -> int:
        """Convert all cells and wait for the end of the conversion; return its start (ns)."""
        self._connect(ALL)
        before = self._now()
        self._bus.write_i2c_block_data(BAROMETER, CONVERT, [1])
        after = self._now()
        end = after + CONVERSION
        self._disconnect_all()
        while (wait := end - self._now()) > 0:
            sleep(wait / s)
        return (before + after) // 2

    def _read_coefficients(self, address: int) -> Coefficients | None:
        """Return what a cell gives twice in a row; None: nothing, or coefficients that no barometer has."""
        data: bytes | None = None
        for _ in range(READINGS):
            before, data = data, self._read(address, COEFFICIENTS, 8)
            if data and data == before:
                return Coefficients.decode(data)
        return None

    def _read(self, address: int, register: int, length: int) -> bytes | None:
        """Read from one cell, while all others are disconnected; return None if it does not answer."""
        try:
            self._connect(address)
            data = bytes(self._bus.read_i2c_block_data(BAROMETER, register, length))
            self._disconnect(address)
        except OSError as error:
            if error.errno not in _NOT_ACKNOWLEDGED:
                raise
            self._disconnect_all()
            return None
        return data

    def _disconnect_all(self) -> None:
        """Disconnect all cells, and check that none answers.

        Raises:
            OSError: if no fingertip acknowledges, or a barometer still answers.
        """
        self._disconnect(ALL)
        try:
            self._bus.read_byte(BAROMETER)
        except OSError as error:
            if error.errno not in _NOT_ACKNOWLEDGED:
                raise
        else:
            raise OSError(errno.EPROTO, "a device at 0x60 answers although all barometers are disconnected")

    def _connect(self, address: int) -> None:
        """Connect the cells of an address."""
        if self._quick:
            try:
                self._bus.write_quick(address)
            except OSError as error:
                if error.errno != errno.EOPNOTSUPP:
                    raise
                self._quick = False
            else:
                return
        try:
            self._bus.write_byte(address, 0)
        except OSError as error:  # the address took effect; the byte is never acknowledged
            if error.errno not in _NOT_ACKNOWLEDGED:
                raise

    def _disconnect(self, address: int) -> None:
        """Disconnect the cells of an address."""
        self._bus.read_byte(address)


class ScanThread:
    """Thread that scans every `period` (ns) until the sensor is lost, for the running event loop.

    The other arguments are those of `Scanner`.
    """

    def __init__(self, path: str, cells: Cells, period: int, now: Callable[[], int]) -> None:
        self._path, self._cells, self._period, self._now = path, cells, period, now
        self._loop = asyncio.get_running_loop()
        self._results = deque[Scan | BaseException]()  # scans, and the error after them
        self._changed, self._ending = asyncio.Event(), Event()

    async def scans(self) -> AsyncGenerator[Scan]:
        """Start the thread, yield its scans, and end it; abandon it if it is blocked.

        Raises:
            EndpointError: if the sensor is lost or the bus hangs.
        """
        thread = Thread(target=self._run, name=f"takktile {self._path}", daemon=True)
        thread.start()
        timeout = TIMEOUT + self._period / s
        try:
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
        finally:
            self._ending.set()
            await asyncio.to_thread(thread.join, TIMEOUT)
            if thread.is_alive():
                log.warning("%s: abandoned a blocked thread", self._path)

    def _run(self) -> None:
        scanner: Scanner | None = None
        try:
            scanner = Scanner(self._path, self._cells, self._now)
            self._scan(scanner)
        except OSError as error:
            self._pass_on(EndpointError(self._path, i2c_reason(error)))
        except BaseException as error:  # noqa: BLE001 - no failure of the device: raised to the runner as it is
            self._pass_on(error)
        finally:
            if scanner is not None:
                scanner.close()

    def _scan(self, scanner: Scanner) -> None:
        """Scan on schedule."""
        period, sampled, answered = self._period, self._now(), False
        due = sampled
        while self._wait_until(due):
            if len(self._results) < BACKLOG:
                scan = scanner.scan()
                if scan.valid.any():
                    sampled, answered = self._now(), True
                else:
                    unplugged = scan.error is not None and scan.error.errno == errno.ENODEV
                    if self._now() - sampled > max(LOST_AFTER, 3 * period) or unplugged:
                        raise scan.error or OSError(errno.ENODATA, _IMPLAUSIBLE)
                if answered:  # a sensor without any sample so far is still lost
                    self._pass_on(scan)
            due = next_scan(due, self._now(), period)

    def _wait_until(self, due: int) -> bool:
        """Wait until `due` (ns) on the clock, which may be slow; return False when the thread must end."""
        while (wait := due - self._now()) > 0 and not self._ending.is_set():
            self._ending.wait(max(wait, SHORTEST_WAIT) / s)
        return not self._ending.is_set()

    def _pass_on(self, result: Scan | BaseException) -> None:
        self._results.append(result)
        try:
            self._loop.call_soon_threadsafe(self._changed.set)
        except RuntimeError:  # the loop is closed, so nobody reads them
            self._ending.set()


def next_scan(due: int, now: int, period: int) -> int:
    """Return when the scan after `due` is due; one that can still begin within its period is not missed.

    >>> next_scan(100, 105, 10), next_scan(100, 119, 10), next_scan(100, 137, 10)
    (110, 110, 130)
    """
    return due + (1 + max(0, now - due - period) // period) * period

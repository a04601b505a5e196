"""Scanner of TakkTile fingertips on an I2C bus; transfers block, so run it in its own thread."""

import errno
import fcntl
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import sleep
from typing import Final, NamedTuple

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

CONVERSION: Final = 3 * ms  # ns, longest duration of a conversion; datasheet
REREAD: Final = 1 * s  # ns, between attempts to read missing coefficients
_NOT_ACKNOWLEDGED: Final = (errno.EREMOTEIO, errno.ENXIO)  # adapters differ
_NO_ANSWER: Final = "no fingertip answers: check the power and the rows"
_REASONS: Final = {
    errno.ENOENT: "the bus does not exist: is I2C enabled?",
    errno.EACCES: "permission denied: is the user in the group i2c?",
    errno.EWOULDBLOCK: "is in use: end the other program, or reset a blocked adapter",
    errno.EBUSY: "a kernel driver uses the address of the barometers: unload it",
    errno.EREMOTEIO: _NO_ANSWER,
    errno.ENXIO: _NO_ANSWER,
    errno.ETIMEDOUT: "timeout: a device blocks the bus; switch the fingertips off and on",
    errno.ENODEV: "the adapter is missing: is it plugged in?",
}


@dataclass(frozen=True)
class Schedule:
    """Fingertips to scan, and the times of the scans.

    Attributes:
        path: Path of the bus, such as /dev/i2c-1.
        rows: Rows of the fingertips.
        period: Time between two scans, ns.
        counted: Counters, incremented by the thread: scans made, of these silent (no cell answered) and late
            (by more than a tenth of the period), and missed.
        coefficients: Coefficients of the 6 cells of each fingertip, filled by the thread; None: not
            read yet, or not plausible.
    """

    path: str
    rows: Sequence[int]
    period: int
    counted: dict[str, int]
    coefficients: Sequence[list[Coefficients | None]]


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


def open_bus(path: str) -> SMBus:
    """Open a bus and lock it against other programs that scan it.

    Raises:
        OSError: if the bus does not exist, cannot be accessed or is locked.
    """
    bus = SMBus()
    try:
        bus.open(path)
        assert bus.fd is not None
        fcntl.flock(bus.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BaseException:
        bus.close()
        raise
    return bus


def i2c_reason(error: OSError) -> str:
    """Return the reason of a bus error, with its likely cause or remedy."""
    text = _REASONS.get(error.errno or 0) or error.strerror or str(error)
    return f"{text} (errno {error.errno})"


class Scanner:
    """Scanner of the fingertips on a bus, which it opens exclusively; all cells are then disconnected.

    A cell is read only while all others are confirmed to be disconnected: connected cells answer at the same
    time, and the result looks like data. After every error all cells are disconnected.

    Args:
        schedule: Bus, rows and coefficients.
        now: Clock of the samples, ns.

    Raises:
        OSError: if the bus cannot be used, or no fingertip answers.
    """

    def __init__(self, schedule: Schedule, now: Callable[[], int]) -> None:
        rows, self._coefficients = schedule.rows, schedule.coefficients
        self._rows, self._now, self._reread = rows, now, 0
        self._overload = [[OverloadDetector() for _ in range(BAROMETERS)] for _ in rows]
        self._bus = open_bus(schedule.path)
        try:
            self._quick = bool(self._bus.funcs & I2cFunc.SMBUS_QUICK)
            self._disconnect_all()
            for fingertip in range(len(rows)):
                for cell in range(BAROMETERS):
                    self._read_coefficients(fingertip, cell)
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
                    overload = self._overload[fingertip][cell]
                    if data is None:
                        overload.valid(None)
                        continue
                    reading = Reading.decode(data)
                    scan.counts[fingertip, cell] = reading.pressure
                    scan.temperature[fingertip, cell] = reading.temperature
                    count = reading.pressure if reading.plausible else None
                    scan.valid[fingertip, cell] = overload.valid(count)
            self._read_missing_coefficients(scan.valid)
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

    def _read_missing_coefficients(self, valid: Flags) -> None:
        """Read the unknown coefficients of one cell that answers now, once per `REREAD` at most."""
        if self._now() < self._reread:
            return
        for fingertip, cells in enumerate(self._coefficients):
            for cell, known in enumerate(cells):
                if known is None and valid[fingertip, cell]:
                    self._read_coefficients(fingertip, cell)
                    self._reread = self._now() + REREAD
                    return

    def _read_coefficients(self, fingertip: int, cell: int) -> None:
        """Read the coefficients of a cell twice; readings that differ are wrong."""
        address = cell_address(self._rows[fingertip], cell)
        data = self._read(address, COEFFICIENTS, 8)
        if data is not None and data == self._read(address, COEFFICIENTS, 8):
            self._coefficients[fingertip][cell] = Coefficients.decode(data)

    def _read(self, address: int, register: int, length: int) -> bytes | None:
        """Read from one cell, while all others are disconnected; return None if it does not answer.

        Raises:
            OSError: on any other error.
        """
        try:
            self._connect(address)
            try:
                return bytes(self._bus.read_i2c_block_data(BAROMETER, register, length))
            finally:
                self._disconnect(address)
        except OSError as error:
            self._disconnect_all()
            if error.errno not in _NOT_ACKNOWLEDGED:
                raise
            return None

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
            raise OSError(errno.EADDRINUSE, "a barometer answers although all are disconnected")

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
            if error.errno != errno.EREMOTEIO:
                raise

    def _disconnect(self, address: int) -> None:
        """Disconnect the cells of an address."""
        self._bus.read_byte(address)

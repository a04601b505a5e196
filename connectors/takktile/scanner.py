"""Scanner of TakkTile fingertips on an I2C bus; it blocks during transfers, so it needs its own thread."""

import errno
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import monotonic_ns, sleep
from typing import Final, NamedTuple

import numpy as np
from smbus2 import I2cFunc

from connectors.takktile.i2c_access import I2cBus
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
from operators.batch import BAROMETERS, Counts, Flags, s

_NOT_ACKNOWLEDGED: Final = (errno.EREMOTEIO, errno.ENXIO)  # adapters differ
_NO_ANSWER: Final = "no fingertip answers: is the power on, are the rows right?"
_REASONS: Final = {
    errno.ENOENT: "there is no such bus: is I2C enabled?",
    errno.EACCES: "may not be opened: does the user belong to the group i2c?",
    errno.EWOULDBLOCK: "is used by another program: end that first",
    errno.EBUSY: "a kernel driver owns the address of the barometers: unload it",
    errno.EREMOTEIO: _NO_ANSWER,
    errno.ENXIO: _NO_ANSWER,
    errno.ETIMEDOUT: "time-out: a device holds the bus; switch the fingertips off and on",
    errno.ENODEV: "the adapter is gone: is it plugged in?",
}


class Scan(NamedTuple):
    """Samples of all cells of all fingertips, converted at one instant."""

    time: int  # ns, start of the conversion
    counts: Counts  # (fingertips, 6) raw, as received, else 0
    temperature: Counts  # (fingertips, 6) raw, as received, else 0
    valid: Flags  # (fingertips, 6) False: no answer, or an implausible one
    error: OSError | None = None  # ended the scan early: nothing of it is valid

    @classmethod
    def blank(cls, time: int, fingertips: int, error: OSError | None = None) -> "Scan":
        """Return a scan without samples."""
        counts, temperature = np.zeros((2, fingertips, BAROMETERS), np.int16)
        return cls(time, counts, temperature, np.zeros((fingertips, BAROMETERS), np.bool_), error)


def i2c_reason(error: OSError) -> str:
    """Return the reason of a bus error, with its likely cause."""
    text = _REASONS.get(error.errno or 0) or error.strerror or str(error)
    return f"{text} (errno {error.errno})"


class Scanner:
    """Fingertips on a bus that is open for this scanner alone; opening it disconnects all cells.

    A cell is read only while all others are known to be disconnected: connected cells answer together, and
    the sum looks like data. After every error all cells are disconnected.

    Args:
        bus: The bus, which is opened here.
        rows: Rows of the fingertips, 0 to 7.
        conversion: Waiting time for a conversion, ns.
        now: Clock of the samples, ns.
        coefficients: Receives the coefficients of each cell (6) of each fingertip; None: no answer yet.

    Raises:
        OSError: if the bus cannot be used, or no fingertip answers.
    """

    def __init__(
        self,
        bus: I2cBus,
        rows: Sequence[int],
        conversion: int,
        now: Callable[[], int],
        coefficients: Sequence[list[Coefficients | None]],
    ) -> None:
        self._rows, self._conversion, self._now, self._coefficients = rows, conversion, now, coefficients
        self._overload = [[OverloadDetector() for _ in range(BAROMETERS)] for _ in rows]
        self._bus = bus.open()
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
        """Convert all cells at once, then read them one by one; takes longer than a conversion."""
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
        """Start a conversion of all cells and wait for its end; return its start (ns)."""
        self._connect(ALL)
        before = self._now()
        self._bus.write_i2c_block_data(BAROMETER, CONVERT, [1])
        after = self._now()
        end = monotonic_ns() + self._conversion
        self._disconnect_all()
        sleep(max(0, end - monotonic_ns()) / s)
        return (before + after) // 2

    def _read_missing_coefficients(self, valid: Flags) -> None:
        """Read the coefficients of one cell that answers now and did not when the bus was opened."""
        for fingertip, cells in enumerate(self._coefficients):
            for cell, known in enumerate(cells):
                if known is None and valid[fingertip, cell]:
                    self._read_coefficients(fingertip, cell)
                    return

    def _read_coefficients(self, fingertip: int, cell: int) -> None:
        data = self._read(cell_address(self._rows[fingertip], cell), COEFFICIENTS, 8)
        self._coefficients[fingertip][cell] = None if data is None else Coefficients.decode(data)

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
        """Disconnect all cells, and check it.

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
            raise OSError(errno.EADDRINUSE, "a barometer answers though all are disconnected")

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
        except OSError as error:  # the address has had its effect; the byte is never acknowledged
            if error.errno != errno.EREMOTEIO:
                raise

    def _disconnect(self, address: int) -> None:
        """Disconnect the cells of an address."""
        self._bus.read_byte(address)

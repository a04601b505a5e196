"""Scanning TakkTile fingertips over I2C: what blocks while it talks to the bus, for a thread of its own."""

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
    Converter,
    Reading,
    cell_address,
)
from operators.batch import BAROMETERS, Counts, Flags, s

_SILENT: Final = (errno.EREMOTEIO, errno.ENXIO)  # the address was not acknowledged; adapters differ
_NOBODY: Final = "no fingertip answers: is the power on, are the rows right?"
_REASONS: Final = {
    errno.ENOENT: "there is no such bus: is I2C enabled?",
    errno.EACCES: "may not be opened: does the user belong to the group i2c?",
    errno.EWOULDBLOCK: "is used by another program: end that first",
    errno.EBUSY: "a kernel driver owns the address of the barometers: unload it",
    errno.EREMOTEIO: _NOBODY,
    errno.ENXIO: _NOBODY,
    errno.ETIMEDOUT: "somebody holds the bus: time-out; switch the fingertips off and on",
    errno.ENODEV: "the adapter is gone: is it plugged in?",
}


class Scan(NamedTuple):
    """All cells of all fingertips, converted at one instant."""

    time: int  # ns, at which the conversion started
    counts: Counts  # (fingertips, 6) raw, as received; 0 where nothing was
    temperature: Counts  # (fingertips, 6) raw, as received; 0 where nothing was
    valid: Flags  # (fingertips, 6) False: it did not answer, or cannot mean what it says
    error: OSError | None = None  # what ended the scan early: nothing of it is valid

    @classmethod
    def blank(cls, time: int, fingertips: int, error: OSError | None = None) -> "Scan":
        """Nothing received."""
        counts, temperature = np.zeros((2, fingertips, BAROMETERS), np.int16)
        return cls(time, counts, temperature, np.zeros((fingertips, BAROMETERS), np.bool_), error)


def reason(error: OSError) -> str:
    """What an error of the bus means for whoever has to mend it."""
    text = _REASONS.get(error.errno or 0) or error.strerror or str(error)
    return f"{text} (errno {error.errno})"


class Scanner:
    """Fingertips on a bus that is open for it alone; opening disconnects all cells and asks who they are.

    No cell is read unless all others are known to be disconnected: those that are connected together answer
    together, and the sum looks like data. After every error all cells are disconnected.

    Args:
        bus: The bus, which is opened here.
        rows: Of the fingertips, 0 to 7.
        conversion: How long a conversion may take, ns.
        now: The clock to stamp with, ns.
        learn: Told of what each cell of each fingertip says of itself; None: it did not answer.

    Raises:
        OSError: if the bus cannot be used, or no fingertip answers.
    """

    def __init__(
        self,
        bus: I2cBus,
        rows: Sequence[int],
        conversion: int,
        now: Callable[[], int],
        learn: Callable[[int, int, Coefficients | None], None],
    ) -> None:
        self._rows, self._conversion, self._now, self._learn = rows, conversion, now, learn
        self._converters = [[Converter() for _ in range(BAROMETERS)] for _ in rows]
        self._unknown = set[tuple[int, int]]()  # cells that have yet to say who they are
        self._bus = bus.open()
        try:
            self._quick = bool(self._bus.funcs & I2cFunc.SMBUS_QUICK)
            self._disconnect()
            for fingertip in range(len(rows)):
                for cell in range(BAROMETERS):
                    self._ask(fingertip, cell)
        except BaseException:
            self._bus.close()
            raise

    def close(self) -> None:
        """Disconnect all cells, if possible, and close the bus."""
        with suppress(OSError):
            self._off(ALL)
        with suppress(OSError):
            self._bus.close()

    def scan(self) -> Scan:
        """Convert all cells at once, then read one after the other; takes a conversion's time, and more."""
        scan = Scan.blank(self._now(), len(self._rows))
        try:
            scan = scan._replace(time=self._convert())
            for fingertip, row in enumerate(self._rows):
                for cell in range(BAROMETERS):
                    data = self._read(cell_address(row, cell), DATA, 4)
                    converter = self._converters[fingertip][cell]
                    if data is None:
                        converter.believe(None)
                        continue
                    reading = Reading.decode(data)
                    scan.counts[fingertip, cell] = reading.pressure
                    scan.temperature[fingertip, cell] = reading.temperature
                    believed = converter.believe(reading.pressure if reading.converted else None)
                    scan.valid[fingertip, cell] = believed
            self._catch_up(scan.valid)
        except OSError as error:
            with suppress(OSError):
                self._disconnect()
            return Scan.blank(scan.time, len(self._rows), error)
        return scan

    def _convert(self) -> int:
        """Start a conversion of all cells and wait for its end; when it started (ns)."""
        self._on(ALL)
        before = self._now()
        self._bus.write_i2c_block_data(BAROMETER, CONVERT, [1])
        after = self._now()
        end = monotonic_ns() + self._conversion
        self._disconnect()
        sleep(max(0, end - monotonic_ns()) / s)
        return (before + after) // 2

    def _catch_up(self, valid: Flags) -> None:
        """Ask one of the cells that did not answer when the bus was opened, and do now, who it is."""
        for fingertip, cell in self._unknown:
            if valid[fingertip, cell]:
                self._ask(fingertip, cell)
                return

    def _ask(self, fingertip: int, cell: int) -> None:
        """Ask a cell for its coefficients."""
        data = self._read(cell_address(self._rows[fingertip], cell), COEFFICIENTS, 8)
        coefficients = None if data is None else Coefficients.decode(data)
        (self._unknown.add if coefficients is None else self._unknown.discard)((fingertip, cell))
        self._learn(fingertip, cell, coefficients)

    def _read(self, address: int, register: int, length: int) -> bytes | None:
        """Read from one cell, which must be the only one connected; None if it does not answer.

        Raises:
            OSError: if more is wrong than that.
        """
        try:
            self._on(address)
            try:
                return bytes(self._bus.read_i2c_block_data(BAROMETER, register, length))
            finally:
                self._off(address)
        except OSError as error:
            self._disconnect()
            if error.errno not in _SILENT:
                raise
            return None

    def _disconnect(self) -> None:
        """Disconnect all cells, and see that they are.

        Raises:
            OSError: if no fingertip hears it, or a barometer answers nevertheless.
        """
        self._off(ALL)
        try:
            self._bus.read_byte(BAROMETER)
        except OSError as error:
            if error.errno not in _SILENT:
                raise
        else:
            raise OSError(errno.EADDRINUSE, "a barometer answers though all are disconnected")

    def _on(self, address: int) -> None:
        """Connect what an address means."""
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
        except OSError as error:  # the address has had its effect, the byte is never acknowledged
            if error.errno != errno.EREMOTEIO:
                raise

    def _off(self, address: int) -> None:
        """Disconnect what an address means."""
        self._bus.read_byte(address)

"""I2C protocol of TakkTile fingertips: addresses, readings and their compensation. No I/O.

A fingertip has six MPL115A2 barometers, all at address 0x60, and an ATtiny with one address per cell: a write
to that address connects the barometer to the bus, a read disconnects it.

Sources: TakkTile's boards and firmware, Freescale's MPL115A2 datasheet, the Linux driver.
"""

import struct
from dataclasses import dataclass
from typing import Final, NamedTuple

BAROMETER: Final = 0x60  # address of every barometer
ALL: Final = 0x06  # address of all cells of all fingertips
ROWS: Final = 8  # fingertips per bus

DATA: Final = 0x00  # register: pressure and temperature, 4 bytes
COEFFICIENTS: Final = 0x04  # register: 8 bytes
CONVERT: Final = 0x12  # register: writing to it starts a conversion

RANGE: Final = 1024  # counts, of the 10-bit converter
HIGHEST: Final = 850  # counts at 65 kPa, an altitude of 3,600 m, of a cell that reads 560 at sea level
COLDEST: Final = 875  # counts, below -40 degC
HOTTEST: Final = 40  # counts, above 105 degC
LEAST: Final = 50.0  # kPa, of the barometer's range
MOST: Final = 115.0  # kPa
EXAMPLE: Final = (410, 507)  # counts of pressure and temperature in the datasheet: 96.6 kPa at 23 degC


def cell_address(row: int, cell: int) -> int:
    """Return the ATtiny's address for a cell; `cell` 6 addresses all six.

    >>> [hex(cell_address(row, cell)) for row, cell in ((0, 0), (0, 5), (1, 0), (7, 5))]
    ['0x0', '0x5', '0x8', '0x3d']
    """
    return row << 3 | cell


class Reading(NamedTuple):
    """Result of one conversion, 10 bits each."""

    pressure: int  # counts, which fall as pressure rises
    temperature: int  # counts, which fall as temperature rises

    @classmethod
    def decode(cls, data: bytes) -> "Reading":
        """Return the reading in the 4 bytes of register `DATA`.

        >>> Reading.decode(bytes.fromhex("6680 7EC0"))
        Reading(pressure=410, temperature=507)
        """
        pressure, temperature = struct.unpack(">HH", data)
        return cls(pressure >> 6, temperature >> 6)

    @property
    def plausible(self) -> bool:
        """True if the temperature is in the barometer's operating range.

        A broken cell, or one before its first conversion, reads 0; a bus without a barometer reads 1023.
        """
        return HOTTEST < self.temperature < COLDEST


class Coefficients(NamedTuple):
    """Calibration of a barometer by its manufacturer."""

    a0: float  # counts
    b1: float
    b2: float
    c12: float  # per count

    @classmethod
    def decode(cls, data: bytes) -> "Coefficients | None":
        """Return the coefficients in the 8 bytes of their register; None if no barometer can have them.

        >>> Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8"))
        Coefficients(a0=2009.75, b1=-2.3758544921875, b2=-0.92047119140625, c12=0.0007901191711425781)
        """
        a0, b1, b2, c12 = struct.unpack(">4h", data)
        found = cls(a0 / 2**3, b1 / 2**13, b2 / 2**14, (c12 >> 2) / 2**22)
        signs = found.a0 > 0 and found.b1 < 0 and found.b2 < 0 and found.c12 >= 0
        return found if signs and LEAST <= found.pressure(*EXAMPLE) <= MOST else None

    def pressure(self, counts: float, temperature: float) -> float:
        """Return the absolute pressure (kPa) of raw counts, as in the datasheet.

        >>> datasheet = Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8"))
        >>> round(datasheet.pressure(410, 507), 3)
        96.587
        """
        compensated = self.a0 + (self.b1 + self.c12 * temperature) * counts + self.b2 * temperature
        return compensated * 65 / 1023 + LEAST


@dataclass
class OverloadDetector:
    """Detector of counts of one cell that have wrapped around (modulo 1024) because of overload.

    Above about 148 kPa the count would be negative. It wraps to a count near 1023, which corresponds to a
    pressure below that at 3,600 m; at higher pressure it is recognised by a jump of half the range.
    """

    _last: int | None = None  # counts; negative while wrapped

    def valid(self, count: int | None) -> bool:
        """Return True if the next count of the cell is valid; None stands for a missing count.

        >>> cell = OverloadDetector()
        >>> [cell.valid(count) for count in (400, 30, 1010, 800, 1020, 25, None, 400)]
        [True, True, False, False, False, True, False, True]
        """
        if count is None:
            self._last = None
            return False
        jumped = self._last is not None and count - self._last > RANGE // 2
        wrapped = count >= RANGE // 2 and (count > HIGHEST or jumped)
        self._last = count - RANGE if wrapped else count
        return not wrapped

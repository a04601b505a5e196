"""What TakkTile fingertips say over I2C and what it means, without any input or output.

A fingertip is six MPL115A2 barometers, which all have the address 0x60, behind an ATtiny that listens to the
addresses of the cells: a write to one connects its barometer to the bus, a read disconnects it. Sources:
TakkTile's boards and firmware, Freescale's MPL115A2 datasheet, the Linux driver.

>>> datasheet = Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8"))
>>> round(datasheet.pressure(410, 507), 3)
96.587
"""

import struct
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from operators.batch import Counts, Reals

BAROMETER: Final = 0x60  # address of every barometer
ALL: Final = 0x06  # address of all cells of all fingertips
ROWS: Final = 8  # fingertips that one bus can tell apart

DATA: Final = 0x00  # register: pressure and temperature, 4 bytes
COEFFICIENTS: Final = 0x04  # register: 8 bytes
CONVERT: Final = 0x12  # register: writing to it starts a conversion

TURN: Final = 1024  # counts, of the 10-bit converter
HIGHEST: Final = 850  # counts at 65 kPa, 3,600 m up, of a cell that reads 560 at sea level
COLDEST: Final = 875  # counts, beyond -40 degC
HOTTEST: Final = 40  # counts, beyond 105 degC


def cell_address(row: int, cell: int) -> int:
    """Address at which an ATtiny listens for one of its cells; `cell` 6: for all of them.

    >>> [hex(cell_address(row, cell)) for row, cell in ((0, 0), (0, 5), (1, 0), (7, 5))]
    ['0x0', '0x5', '0x8', '0x3d']
    """
    return row << 3 | cell


class Reading(NamedTuple):
    """What one conversion found, 10 bits each."""

    pressure: int  # counts, which fall as pressure rises
    temperature: int  # counts, which fall as temperature rises

    @classmethod
    def decode(cls, data: bytes) -> "Reading":
        """The 4 bytes from `DATA` on.

        >>> Reading.decode(bytes.fromhex("6680 7EC0"))
        Reading(pressure=410, temperature=507)
        """
        pressure, temperature = struct.unpack(">HH", data)
        return cls(pressure >> 6, temperature >> 6)

    @property
    def converted(self) -> bool:
        """Whether a barometer can have converted this.

        Both are 0 before the first conversion and of a broken cell, both full where nobody drives the bus: no
        barometer works at such temperatures.
        """
        return HOTTEST < self.temperature < COLDEST


class Coefficients(NamedTuple):
    """What a barometer knows of itself, set when it was made."""

    a0: float  # counts
    b1: float
    b2: float
    c12: float  # per count

    @classmethod
    def decode(cls, data: bytes) -> "Coefficients | None":
        """The 8 bytes from `COEFFICIENTS` on; None where they are no barometer's.

        >>> Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8"))
        Coefficients(a0=2009.75, b1=-2.3758544921875, b2=-0.92047119140625, c12=0.0007901191711425781)
        """
        if len(set(data)) == 1:  # nobody spoke
            return None
        a0, b1, b2, c12 = struct.unpack(">4h", data)
        return cls(a0 / 2**3, b1 / 2**13, b2 / 2**14, (c12 >> 2) / 2**22)

    def pressure(self, pressure: float, temperature: float) -> float:
        """Absolute pressure (kPa) of raw counts."""
        compensated = self.a0 + (self.b1 + self.c12 * temperature) * pressure + self.b2 * temperature
        return compensated * 65 / 1023 + 50


UNKNOWN: Final = Coefficients(np.nan, np.nan, np.nan, np.nan)


def compensate(counts: Counts, temperature: Counts, coefficients: list[Coefficients | None]) -> Reals:
    """Absolute pressure (kPa) of a fingertip's raw counts (n, 6); NaN where coefficients are unknown.

    >>> datasheet = Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8"))
    >>> raw = np.full((2, 6), 410, np.int16)
    >>> compensate(raw, raw + np.int16(97), [datasheet] * 5 + [None])[0].round(3).tolist()
    [96.587, 96.587, 96.587, 96.587, 96.587, nan]
    """
    cells: Reals = np.array([known or UNKNOWN for known in coefficients])  # (6, 4)
    a0, b1, b2, c12 = cells.T
    p, t = counts.astype(np.float64), temperature.astype(np.float64)
    kpa: Reals = (a0 + (b1 + c12 * t) * p + b2 * t) * 65 / 1023 + 50
    return kpa


def celsius(temperature: Counts) -> Reals:
    """Temperature (degC) of raw counts, uncertain by 5 degC: the Linux driver takes 472 for 25 degC.

    >>> celsius(np.array([498, 605], np.int16)).tolist()
    [25.0, 5.0]
    """
    return 25 - (temperature.astype(np.float64) - 498) / 5.35


@dataclass
class Converter:
    """Follows one cell past the end of its converter, where the count wraps (modulo 1024).

    Beyond about 148 kPa the count would be negative. It comes as one near 1023, which reads as less pressure
    than there is where people work; deeper in, as one that only a jump of half the range could reach.
    """

    _last: int | None = None  # counts, below 0 while wrapped

    def believe(self, count: int | None) -> bool:
        """Whether the next count, None: there was none, means what it says.

        >>> cell = Converter()
        >>> [cell.believe(count) for count in (400, 30, 1010, 800, 1020, 25, None, 400)]
        [True, True, False, False, False, True, False, True]
        """
        if count is None:
            self._last = None
            return False
        jumped = self._last is not None and count - self._last > TURN // 2
        wrapped = count >= TURN // 2 and (count > HIGHEST or jumped)
        self._last = count - TURN if wrapped else count
        return not wrapped

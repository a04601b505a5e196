"""An emulated TakkTile fingertip on I2C: one ATtiny and six MPL115A2 barometers.

The ATtiny connects barometers by address alone: a write connects, a read disconnects. All barometers have
the same address. Sources: TakkTile's board files and firmware; Freescale, "MPL115A2" datasheet.
"""

import struct
from collections.abc import Callable
from typing import Final, Protocol

from connectors.takktile.takktile_protocol import ALL, COEFFICIENTS, CONVERT
from operators.batch import BAROMETERS, Counts, ms

CONVERSION: Final = 3 * ms  # ns; the datasheet's maximum
EVERY_CELL: Final = 6  # column number that addresses all cells of a row
REGISTERS: Final = 0x13  # bytes in the register file


class CellSource(Protocol):
    """Source of the barometers' counts, such as `connectors.emulators.shared_scene.SharedScene`."""

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Return raw counts of pressure and temperature, (6,) each, of a conversion begun at `time` (ns)."""
        ...


class Barometer:
    """One MPL115A2: a register file and a pointer; a write sets the pointer, a read starts there.

    Args:
        coefficients: The 8 coefficient bytes.
        conversion: Duration of a conversion (ns).
        sample: Returns raw counts of pressure and temperature at an instant (ns).
    """

    def __init__(
        self, coefficients: bytes, conversion: int, sample: Callable[[int], tuple[int, int]]
    ) -> None:
        self._coefficients, self._conversion, self._sample = coefficients, conversion, sample
        self.power_up()

    def power_up(self) -> None:
        """Reset the registers to their state before the first conversion."""
        self.registers, self._pointer = bytearray(REGISTERS), 0
        self.registers[COEFFICIENTS : COEFFICIENTS + 8] = self._coefficients
        self._pending: tuple[int, bytes] | None = None  # (completion time in ns, converted bytes)

    def write(self, data: bytes, now: int) -> None:
        """Set the pointer, or start a conversion, at an instant (ns)."""
        self._complete(now)
        self._pointer = data[0] if data else self._pointer
        if data[:1] == bytes([CONVERT]):
            self._pending = now + self._conversion, self.convert(now)

    def convert(self, now: int) -> bytes:
        """Return the 4 bytes of a conversion begun at an instant (ns): two 10-bit counts, left-aligned."""
        pressure, temperature = self._sample(now)
        return struct.pack(">HH", pressure << 6, temperature << 6)

    def read(self, length: int, now: int) -> bytes:
        """Read from the pointer on at an instant (ns); the previous sample until a conversion ends."""
        self._complete(now)
        start, self._pointer = self._pointer, self._pointer + length
        return bytes(self.registers[start : start + length]).ljust(length, b"\0")

    def _complete(self, now: int) -> None:
        if self._pending is not None and now >= self._pending[0]:
            self.registers[:4] = self._pending[1]
            self._pending = None


class Fingertip:
    """The ATtiny of one row and its six barometers.

    The coefficients are the datasheet's example; a0 increases by one count per cell to distinguish the cells.
    """

    barometer = Barometer  # class of the cells

    def __init__(self, row: int, finger: int, source: CellSource, conversion: int = CONVERSION) -> None:
        self._row = row
        self.on = [False] * BAROMETERS

        def cell(column: int) -> Barometer:
            def sample(now: int) -> tuple[int, int]:
                pressure, temperature = source.touch(finger, now)
                return int(pressure[column]), int(temperature[column])

            coefficients = struct.pack(">4H", 0x3ECE + 8 * column, 0xB3F9, 0xC517, 0x33C8)
            return self.barometer(coefficients, conversion, sample)

        self.cells = [cell(column) for column in range(BAROMETERS)]

    def switch(self, address: int, *, on: bool) -> bool:
        """Connect or disconnect the barometers of an address; return whether the ATtiny acknowledges it."""
        row, column = divmod(address, 8)
        if (row != self._row and address != ALL) or column > EVERY_CELL:
            return False
        self.on = [on if column in (cell, EVERY_CELL) else was for cell, was in enumerate(self.on)]
        return True

    @property
    def connected(self) -> list[Barometer]:
        """Barometers that are connected to the bus."""
        return [barometer for barometer, on in zip(self.cells, self.on, strict=True) if on]

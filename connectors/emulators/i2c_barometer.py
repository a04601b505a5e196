"""An emulated TakkTile fingertip as its I2C bus sees it: an ATtiny and the MPL115A2 barometers behind it.

Sources: TakkTile's boards and firmware, Freescale's MPL115A2 datasheet.
"""

import struct
from collections.abc import Callable
from enum import Enum, auto
from typing import Final, Protocol

from operators.batch import BAROMETERS, Counts, ms

BAROMETER: Final = 0x60  # address of every barometer
CONVERSION: Final = 3 * ms  # datasheet, at most

_ALL, _EVERY_CELL = 0x06, 6  # address of all cells of all fingertips; column of all cells of one
_COEFFICIENTS, _CONVERT, _REGISTERS = 0x04, 0x12, 0x13


class Skin(Protocol):
    """What fingertips feel; `connectors.emulators.shared_scene.Lab` is one."""

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Raw counts of pressure and temperature of a conversion that starts at `time` (ns), (6,) each."""
        ...


class Defect(Enum):
    """What can be wrong with a barometer."""

    DEAD = auto()  # it does not answer
    STUCK = auto()  # it repeats what it converted last
    ZERO = auto()  # it converts everything to 0


class Barometer:
    """One MPL115A2: registers that are read from a pointer on, which a write sets.

    Attributes:
        defect: What is wrong with it; None: nothing.
        overload: Counts by which the pressure is higher than the skin says; what leaves the range wraps.
    """

    def __init__(self, coefficients: bytes, conversion: int, feel: Callable[[int], tuple[int, int]]) -> None:
        self.defect: Defect | None = None
        self.overload = 0
        self._coefficients, self._conversion, self._feel = coefficients, conversion, feel
        self.power_up()

    def power_up(self) -> None:
        """Be as before the first conversion."""
        self._registers, self._pointer = bytearray(_REGISTERS), 0
        self._registers[_COEFFICIENTS : _COEFFICIENTS + 8] = self._coefficients
        self._pending: tuple[int, bytes] | None = None  # ns at which it is complete, and the result

    def write(self, data: bytes, now: int) -> None:
        """Take bytes at an instant (ns): where to read from next, or that a conversion is to start."""
        self._complete(now)
        self._pointer = data[0] if data else self._pointer
        if data[:1] == bytes([_CONVERT]) and self.defect is not Defect.STUCK:
            pressure, temperature = self._feel(now)
            pressure = (pressure - self.overload) % 1024
            result = struct.pack(">HH", pressure << 6, temperature << 6)
            self._pending = now + self._conversion, bytes(4) if self.defect is Defect.ZERO else result

    def read(self, length: int, now: int) -> bytes:
        """The bytes from the pointer on at an instant (ns), the old sample until the next is complete."""
        self._complete(now)
        start, self._pointer = self._pointer, self._pointer + length
        return bytes(self._registers[start : start + length]).ljust(length, b"\0")

    def _complete(self, now: int) -> None:
        if self._pending is not None and now >= self._pending[0]:
            self._registers[:4] = self._pending[1]
            self._pending = None


class Fingertip:
    """The ATtiny of one row and its six barometers: it looks at addresses only.

    Its cells have the datasheet's example coefficients, a0 one count higher from cell to cell.

    Attributes:
        cells: The barometers.
        plugged: Whether its cable is in.
    """

    def __init__(self, row: int, finger: int, skin: Skin, conversion: int = CONVERSION) -> None:
        self.plugged = True
        self._row = row
        self._on = [False] * BAROMETERS

        def cell(column: int) -> Barometer:
            def feel(now: int) -> tuple[int, int]:
                pressure, temperature = skin.touch(finger, now)
                return int(pressure[column]), int(temperature[column])

            coefficients = struct.pack(">4H", 0x3ECE + 8 * column, 0xB3F9, 0xC517, 0x33C8)
            return Barometer(coefficients, conversion, feel)

        self.cells = [cell(column) for column in range(BAROMETERS)]

    def unplug(self) -> None:
        """Pull its cable: nothing of it answers."""
        self.plugged = False

    def plug(self) -> None:
        """Put its cable in: it powers up, with all barometers off."""
        self.plugged, self._on = True, [False] * BAROMETERS
        for barometer in self.cells:
            barometer.power_up()

    def switch(self, address: int, *, on: bool) -> bool:
        """Connect or disconnect the barometers that an address means; whether it means any."""
        row, column = divmod(address, 8)
        if not self.plugged or (row != self._row and address != _ALL) or column > _EVERY_CELL:
            return False
        self._on = [on if column in (each, _EVERY_CELL) else was for each, was in enumerate(self._on)]
        return True

    @property
    def connected(self) -> list[Barometer]:
        """The barometers that listen at 0x60 now."""
        if not self.plugged:
            return []
        return [
            barometer
            for barometer, on in zip(self.cells, self._on, strict=True)
            if on and barometer.defect is not Defect.DEAD
        ]

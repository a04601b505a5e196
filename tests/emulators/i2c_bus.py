"""Emulated I2C bus with TakkTile fingertips, adapters that refuse as real ones do, and faults on command.

A fingertip is one ATtiny and six MPL115A2 barometers, which all have the same address. The ATtiny connects
barometers by address alone: a write connects, a read disconnects. Several connected barometers answer at the
same time: each pulls the lines low, so the host reads the bitwise AND of their bytes. Errors have the errno
that Linux reports. Sources: TakkTile's board files and firmware; Freescale, "MPL115A2" datasheet.
"""

import errno
import os
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import reduce
from threading import Event
from time import sleep, time_ns
from typing import Final, NamedTuple, Protocol

from connectors.takktile.takktile_protocol import ALL, BAROMETER, COEFFICIENTS, CONVERT, RANGE
from operators.batch import BAROMETERS, Counts, ms

CONVERSION: Final = 3 * ms  # ns; the datasheet's maximum
EVERY_CELL: Final = 6  # column number that addresses all cells of a row
REGISTERS: Final = 0x13  # bytes in the register file
RELEASED: Final = 0xFF  # byte read while no device pulls the lines low


class Skin(Protocol):
    """Source of the barometers' counts."""

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Return raw counts of pressure and temperature, (6,) each, of a conversion begun at `time` (ns)."""
        ...


class Defect(Enum):
    """Defects of a barometer."""

    DEAD = auto()  # it does not answer
    STUCK = auto()  # it repeats its last conversion
    ZERO = auto()  # it converts everything to 0


class Cell:
    """One MPL115A2: a register file and a pointer; a write sets the pointer, a read starts there.

    Args:
        coefficients: The 8 coefficient bytes.
        conversion: Duration of a conversion (ns).
        sample: Returns raw counts of pressure and temperature at an instant (ns).

    Attributes:
        defect: Defect; None: it works.
        overload: Pressure above that of its source, counts.
    """

    def __init__(
        self, coefficients: bytes, conversion: int, sample: Callable[[int], tuple[int, int]]
    ) -> None:
        self.defect: Defect | None = None
        self.overload = 0
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
            self._pending = now + self._conversion, self._convert(now)

    def read(self, length: int, now: int) -> bytes:
        """Read from the pointer on at an instant (ns); the previous sample until a conversion ends."""
        self._complete(now)
        start, self._pointer = self._pointer, self._pointer + length
        return bytes(self.registers[start : start + length]).ljust(length, b"\0")

    def _convert(self, now: int) -> bytes:
        """Return the 4 bytes of a conversion begun at an instant (ns): two 10-bit counts, left-aligned."""
        if self.defect is Defect.STUCK:
            return bytes(self.registers[:4])
        if self.defect is Defect.ZERO:
            return bytes(4)
        pressure, temperature = self._sample(now)
        return struct.pack(">HH", (pressure - self.overload) % RANGE << 6, temperature << 6)

    def _complete(self, now: int) -> None:
        if self._pending is not None and now >= self._pending[0]:
            self.registers[:4] = self._pending[1]
            self._pending = None


class Fingertip:
    """The ATtiny of one row and its six barometers; its cable can be pulled.

    The coefficients are the datasheet's example; a0 increases by one count per cell to distinguish the cells.
    """

    def __init__(self, row: int, finger: int, skin: Skin, conversion: int) -> None:
        self._row, self.plugged = row, True
        self.on = [False] * BAROMETERS

        def cell(column: int) -> Cell:
            def sample(now: int) -> tuple[int, int]:
                pressure, temperature = skin.touch(finger, now)
                return int(pressure[column]), int(temperature[column])

            coefficients = struct.pack(">4H", 0x3ECE + 8 * column, 0xB3F9, 0xC517, 0x33C8)
            return Cell(coefficients, conversion, sample)

        self.cells = [cell(column) for column in range(BAROMETERS)]

    def plug(self) -> None:
        """Power up, with all barometers off."""
        self.plugged, self.on = True, [False] * BAROMETERS
        for cell in self.cells:
            cell.power_up()

    def switch(self, address: int, *, on: bool) -> bool:
        """Connect or disconnect the barometers of an address; return whether the ATtiny acknowledges it."""
        row, column = divmod(address, 8)
        if not self.plugged or (row != self._row and address != ALL) or column > EVERY_CELL:
            return False
        self.on = [on if column in (cell, EVERY_CELL) else was for cell, was in enumerate(self.on)]
        return True

    @property
    def connected(self) -> list[Cell]:
        """Barometers that are connected to the bus and answer."""
        return [
            cell
            for cell, on in zip(self.cells, self.on, strict=True)
            if on and self.plugged and cell.defect is not Defect.DEAD
        ]


class Message(NamedTuple):
    """One message of a transfer: a write to an address, or a read from it."""

    address: int  # 7 bits
    data: bytes = b""  # bytes to write
    length: int | None = None  # bytes to read; None for a write


@dataclass(frozen=True)
class Adapter:
    """Capabilities of a bus adapter.

    Attributes:
        empty: It sends messages without data, as SMBus's quick command is (errno 95 if not).
        speed: Bits per second; None: transfers take no time.
    """

    empty: bool = True
    speed: float | None = None


RASPBERRY_PI: Final = Adapter()  # i2c-bcm2835, models 0 to 4
DESIGNWARE: Final = Adapter(empty=False)  # i2c-designware; i2c-omap of a BeagleBone alike


@dataclass
class Fault:
    """Messages that fail; see `EmulatedI2cBus.fail`."""

    number: int
    address: int | None
    after: int
    times: int

    def strikes(self, address: int) -> bool:
        """Count a message to an address; return whether it fails."""
        if not self.times or self.address not in (None, address):
            return False
        if self.after:
            self.after -= 1
            return False
        self.times -= 1
        return True


class EmulatedI2cBus:
    """An I2C bus with fingertips; any thread may command its faults.

    Args:
        skin: Source of the counts.
        rows: Finger of the source for each row (0 to 7).
        adapter: Adapter that drives it.
        conversion: Duration of a conversion (ns).
        now: Clock of the source (ns).

    Attributes:
        fingertips: Fingertips by row.
        busy: Addresses that a kernel driver owns (errno 16).
        away: The adapter has been taken away.
        lost: The errno with which connections opened before that fail.
        generation: How often the adapter has been taken away.
        transfers, octets: Transfers, and bytes that they sent, addresses included.
    """

    def __init__(
        self,
        skin: Skin,
        rows: Mapping[int, int] | None = None,
        *,
        adapter: Adapter = RASPBERRY_PI,
        conversion: int = CONVERSION,
        now: Callable[[], int] = time_ns,
    ) -> None:
        served = {0: 0} if rows is None else rows
        self.fingertips = {row: Fingertip(row, finger, skin, conversion) for row, finger in served.items()}
        self.adapter, self._now = adapter, now
        self.busy = set[int]()
        self.away, self.lost = False, errno.ENODEV
        self.generation = self.transfers = self.octets = 0
        self._faults: list[Fault] = []
        self._flowing = Event()
        self._flowing.set()

    def fail(self, number: int, *, address: int | None = None, after: int = 0, times: int = 1) -> None:
        """Let `times` messages (to one address) fail with an errno and without effect, `after` that work.

        121 is a NACK, 110 a time-out of the adapter, 5 an I/O error.
        """
        self._faults.append(Fault(number, address, after, times))

    def heal(self) -> None:
        """Take back every `fail`."""
        self._faults.clear()

    def wedge(self) -> None:
        """Hold the bus: transfers block until `release`, then time out (errno 110)."""
        self._flowing.clear()

    def release(self) -> None:
        """Let go of the bus."""
        self._flowing.set()

    def unplug(self) -> None:
        """Pull the cable of all fingertips."""
        for fingertip in self.fingertips.values():
            fingertip.plugged = False

    def plug(self) -> None:
        """Put it in again: the fingertips power up."""
        for fingertip in self.fingertips.values():
            fingertip.plug()

    def remove(self, number: int = errno.ENODEV) -> None:
        """Take the adapter away, as one on USB can be: open connections fail for good, with errno 19 or 6."""
        self.away, self.lost = True, number
        self.generation += 1

    def restore(self) -> None:
        """Put the adapter back, to be opened again."""
        self.away = False

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Send messages in one transfer; return the bytes read by each, empty for a write.

        Raises:
            OSError: if the adapter cannot send them, no device acknowledges an address, or a fault strikes.
        """
        if not self._flowing.is_set():
            self._flowing.wait()
            raise os_error(errno.ETIMEDOUT)
        if not self.adapter.empty and any(not message.data and not message.length for message in messages):
            raise os_error(errno.EOPNOTSUPP)
        self.transfers += 1
        return [self._send(message) for message in messages]

    def _send(self, message: Message) -> bytes:
        """Send one message; return the bytes read."""
        for fault in self._faults:
            if fault.strikes(message.address):
                raise os_error(fault.number)
        octets = 1  # the address
        try:
            answer = self._access(message) if message.address == BAROMETER else self._switch(message)
            octets += len(message.data) or len(answer)
            return answer
        finally:
            self.octets += octets
            if self.adapter.speed is not None:
                sleep(9 * octets / self.adapter.speed)  # 8 bits and an acknowledgement each

    def _access(self, message: Message) -> bytes:
        """Write to the connected barometers, or read from them."""
        cells = [cell for fingertip in self.fingertips.values() for cell in fingertip.connected]
        if not cells:
            raise os_error(errno.EREMOTEIO)
        now = self._now()
        if message.length is None:
            for cell in cells:
                cell.write(message.data, now)
            return b""
        answers = [cell.read(message.length, now) for cell in cells]
        return bytes(reduce(int.__and__, octets) for octets in zip(*answers, strict=True))

    def _switch(self, message: Message) -> bytes:
        """Connect or disconnect barometers; the ATtinys act on the address and never acknowledge data."""
        on = message.length is None
        acknowledged = [fingertip.switch(message.address, on=on) for fingertip in self.fingertips.values()]
        if message.data or not any(acknowledged):
            raise os_error(errno.EREMOTEIO)
        return bytes([RELEASED]) * (message.length or 0)


def os_error(number: int) -> OSError:
    """Return the OSError of an errno."""
    return OSError(number, os.strerror(number))

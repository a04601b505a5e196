"""Emulated I2C bus with TakkTile fingertips behind an unmodified smbus2, and faults on command.

A fingertip is one ATtiny and six MPL115A2 barometers, which all have the same address. The ATtiny connects
barometers by address alone: a write connects, a read disconnects. Several connected barometers answer at the
same time: each pulls the lines low, so the host reads the bitwise AND of their bytes. Errors have the errno
that Linux reports. Sources: TakkTile's board files and firmware; Freescale, "MPL115A2" datasheet.

smbus2 asks the operating system three things: ``os.open``, ``fcntl.ioctl`` and ``os.close``. While a bus is
`served`, these calls of smbus2 reach the bus where they are about its path. All else of smbus2 stays real:
the structure that it hands to the kernel is declared here once more, after Linux's ``i2c-dev.h``.
"""

import errno
import os
import struct
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from ctypes import POINTER, Structure, c_uint8, c_uint32, c_ulong, string_at
from dataclasses import dataclass
from enum import Enum, auto
from functools import reduce
from threading import Event
from time import sleep, time_ns
from typing import Any, ClassVar, Final, Protocol, TypeAlias, cast

import numpy as np
import smbus2.smbus2

from connectors.takktile.takktile_protocol import ALL, BAROMETER, COEFFICIENTS, CONVERT, RANGE
from operators.batch import BAROMETERS, Counts, ms

CONVERSION: Final = 3 * ms  # ns; the datasheet's maximum
EVERY_CELL: Final = 6  # column number that addresses all cells of a row
REGISTERS: Final = 0x13  # bytes in the register file
RELEASED: Final = 0xFF  # byte read while no device pulls the lines low
NOT_ACKNOWLEDGED = errno.EREMOTEIO  # of most adapters; others report ENXIO


class Skin(Protocol):
    """Source of the barometers' counts."""

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Return raw counts of pressure and temperature, (6,) each, of a conversion begun at `time` (ns)."""
        ...


class Table:
    """Skin whose counts of pressure are rows 10 ms apart, (n, 6) by finger; they begin again at the end."""

    def __init__(self, *counts: Counts) -> None:
        self._counts, self._began = counts, time_ns()

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        """Return the row of an instant."""
        rows = self._counts[finger]
        pressure = rows[max(0, time - self._began) // (10 * ms) % len(rows)]
        return pressure, np.full_like(pressure, 507)


class Defect(Enum):
    """Defects of a barometer."""

    DEAD = auto()  # it does not answer
    ZERO = auto()  # it converts everything to 0


class Cell:
    """One MPL115A2: a register file and a pointer; a write sets the pointer, a read starts there.

    `sample` returns raw counts of pressure and temperature at an instant (ns).
    """

    def __init__(
        self, coefficients: bytes, conversion: int, sample: Callable[[int], tuple[int, int]]
    ) -> None:
        self.defect: Defect | None = None
        self.overload = 0  # counts, of pressure above that of its source
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


@dataclass
class Fault:
    """Messages that fail; see `EmulatedI2cBus.fail`."""

    number: int
    address: int | None
    after: int
    times: int
    struck: int = 0

    def strikes(self, address: int) -> bool:
        """Count a message to an address; return whether it fails."""
        if self.struck == self.times or self.address not in (None, address):
            return False
        if self.after:
            self.after -= 1
            return False
        self.struck += 1
        return True


class EmulatedI2cBus:
    """An I2C bus with fingertips; any thread may command its faults.

    `rows` has the finger of the source `skin` for each row (0 to 7).

    Attributes:
        fingertips: Fingertips by row.
        lost, generation: Errno of connections that were opened before, and how often it was taken away.
        quick: The adapter sends messages without data, as SMBus's quick command is; others refuse (errno 95).
        speed: Bits per second; None: messages take no time.
        transfers: Transactions.
    """

    def __init__(
        self, skin: Skin, rows: Mapping[int, int] | None = None, *, conversion: int = CONVERSION
    ) -> None:
        served = {0: 0} if rows is None else rows
        self.fingertips = {row: Fingertip(row, finger, skin, conversion) for row, finger in served.items()}
        self.quick, self.speed = True, cast("float | None", None)
        self.lost = errno.ENODEV
        self.generation = self.transfers = 0
        self._faults: list[Fault] = []
        self._flowing = Event()
        self._flowing.set()

    def fail(self, number: int, *, address: int | None = None, after: int = 0, times: int = 1) -> None:
        """Let `times` messages (to one address) fail with an errno and without effect, `after` that work.

        121 is a NACK, 110 a time-out of the adapter, 5 an I/O error.
        """
        self._faults.append(Fault(number, address, after, times))

    def heal(self) -> int:
        """Take back every `fail`; return how many messages failed because of them."""
        struck = sum(fault.struck for fault in self._faults)
        self._faults.clear()
        return struck

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
        """Plug the adapter, as one on USB, out and in: open connections fail for good, with errno 19 or 6."""
        self.lost = number
        self.generation += 1

    def write(self, address: int, data: bytes = b"") -> None:
        """Send a message that writes.

        Raises:
            OSError: if the adapter cannot send it, no device acknowledges the address, or a fault strikes.
        """
        self._begin(address, 1 + len(data))
        if not data and not self.quick:
            raise os_error(errno.EOPNOTSUPP)
        if address == BAROMETER:
            cells, now = self._connected(), time_ns()
            for cell in cells:
                cell.write(data, now)
        elif not self._switch(address, on=True) or data:  # the ATtinys act on the address and refuse data
            raise os_error(NOT_ACKNOWLEDGED)

    def read(self, address: int, length: int) -> bytes:
        """Send a message that reads, and return the bytes; errors are those of `write`."""
        self._begin(address, 1 + length)
        if address == BAROMETER:
            cells, now = self._connected(), time_ns()
            answers = [cell.read(length, now) for cell in cells]
            return bytes(reduce(int.__and__, octets) for octets in zip(*answers, strict=True))
        if not self._switch(address, on=False):
            raise os_error(NOT_ACKNOWLEDGED)
        return bytes([RELEASED]) * length

    def _begin(self, address: int, octets: int) -> None:
        if not self._flowing.is_set():
            self._flowing.wait()
            raise os_error(errno.ETIMEDOUT)
        for fault in self._faults:
            if fault.strikes(address):
                raise os_error(fault.number)
        if self.speed is not None:
            sleep(9 * octets / self.speed)  # 8 bits and an acknowledgement each

    def _connected(self) -> list[Cell]:
        """Return the barometers that answer; they answer together."""
        cells = [cell for fingertip in self.fingertips.values() for cell in fingertip.connected]
        if not cells:
            raise os_error(NOT_ACKNOWLEDGED)
        return cells

    def _switch(self, address: int, *, on: bool) -> bool:
        """Connect or disconnect barometers; return whether an ATtiny acknowledges the address."""
        acknowledged = [fingertip.switch(address, on=on) for fingertip in self.fingertips.values()]
        return True in acknowledged


def os_error(number: int) -> OSError:
    """Return the OSError of an errno."""
    return OSError(number, os.strerror(number))


_SLAVE, _FUNCTIONS, _SMBUS = 0x0703, 0x0705, 0x0720  # requests
_READ: Final = 1
_LONGEST: Final = 32  # bytes of a block
_EMULATED: Final = 0x0CFF0009  # functions of an adapter that sends messages, block data excepted
_EMULATED_QUICK: Final = 0x00010000  # among them

_Argument: TypeAlias = int | Structure | c_ulong


class _Transaction(Structure):
    """struct i2c_smbus_ioctl_data; the union it points to holds a byte or a block: here its bytes."""

    _fields_: ClassVar = [
        ("read_write", c_uint8),
        ("command", c_uint8),
        ("size", c_uint32),
        ("data", POINTER(c_uint8)),
    ]


@contextmanager
def served(bus: EmulatedI2cBus, path: str) -> Generator[EmulatedI2cBus]:
    """Let smbus2 find a bus at a path, in all threads; at the end a wedged bus is released."""
    names = smbus2.smbus2.__dict__
    system, control = names["os"], names["ioctl"]
    backing = os.memfd_create("i2c")
    device = _Device(bus, path, backing, system, control)
    names["os"], names["ioctl"] = device, device.ioctl
    try:
        yield bus
    finally:
        names["os"], names["ioctl"] = system, control
        os.close(backing)
        bus.release()


class _Device:
    """Stand-in for the module ``os`` and the function ``ioctl`` in smbus2."""

    O_RDWR = os.O_RDWR

    def __init__(self, bus: EmulatedI2cBus, path: str, backing: int, system: Any, control: Any) -> None:
        self._bus, self._path, self._backing = bus, path, backing
        self._system, self._control = system, control  # that smbus2 had before
        self._generations = dict[int, int]()  # by descriptor, of the bus when it was opened
        self._addresses = dict[int, int]()  # by descriptor

    def open(self, path: str, flags: int) -> int:
        """Return a new descriptor, which smbus2 may lock and close as any other."""
        if path != self._path:
            return int(self._system.open(path, flags))
        descriptor = os.open(f"/proc/self/fd/{self._backing}", flags)
        self._generations[descriptor] = self._bus.generation
        return descriptor

    def close(self, descriptor: int) -> None:
        self._generations.pop(descriptor, None)
        self._system.close(descriptor)

    def ioctl(self, descriptor: int, request: int, argument: _Argument = 0) -> int:
        """Execute one request of ``i2c-dev.h``."""
        if descriptor not in self._generations:
            return int(self._control(descriptor, request, argument))
        if self._generations[descriptor] != self._bus.generation:
            raise os_error(self._bus.lost)
        if request == _SLAVE and isinstance(argument, int):
            self._addresses[descriptor] = argument
        elif request == _FUNCTIONS and not isinstance(argument, int):
            quick = 0 if self._bus.quick else _EMULATED_QUICK
            c_ulong.from_buffer(argument).value = _EMULATED & ~quick
        elif request == _SMBUS and not isinstance(argument, int):
            self._transact(self._addresses[descriptor], _Transaction.from_buffer(argument))
        else:
            raise os_error(errno.ENOTTY)
        return 0

    def _transact(self, address: int, asked: _Transaction) -> None:
        """Execute an SMBus transaction, as messages; a block begins with its length."""
        bus, reads = self._bus, asked.read_write == _READ
        bus.transfers += 1
        match asked.size:
            case 0 if not reads:  # quick
                bus.write(address)
            case 1 if reads:  # byte
                asked.data[0] = bus.read(address, 1)[0]
            case 1:
                bus.write(address, bytes([asked.command]))
            case 8 if reads:  # block
                bus.write(address, bytes([asked.command]))
                for octet, value in enumerate(bus.read(address, asked.data[0]), 1):
                    asked.data[octet] = value
            case 8:
                block = string_at(asked.data, _LONGEST + 2)
                bus.write(address, bytes([asked.command]) + block[1 : 1 + block[0]])
            case _:
                raise os_error(errno.EOPNOTSUPP)

"""Emulated I2C bus with TakkTile fingertips, for `TakkTile` in the same process.

Several connected barometers answer at the same time: each pulls the lines low, so the host reads the bitwise
AND of their bytes. Errors have the errno that Linux reports.
"""

import errno
import os
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from time import time_ns
from types import MappingProxyType
from typing import Final, NamedTuple

from smbus2 import I2cFunc

from connectors.emulators.i2c_barometer import CONVERSION, CellSource, Fingertip
from connectors.takktile.takktile_protocol import BAROMETER, ROWS
from operators.errors import ParameterError

ONE_FINGERTIP: Final = MappingProxyType({0: 0})  # finger by row
RELEASED: Final = 0xFF  # byte read while no device pulls the lines low
VIRTUAL: Final = "virtual I2C bus"


class Message(NamedTuple):
    """One message of a transfer: a write to an address, or a read from it."""

    address: int  # 7 bits
    data: bytes = b""  # bytes to write
    length: int | None = None  # bytes to read; None for a write


def os_error(number: int) -> OSError:
    """Return the OSError of an errno."""
    return OSError(number, os.strerror(number))


class EmulatedI2cBus:
    """An I2C bus with fingertips; pass it to `TakkTile` as its bus.

    Args:
        source: Source of the counts, such as a `SharedScene`.
        rows: Finger of the source for each row (0 to 7).
        conversion: Duration of a conversion (ns).
        now: Clock of the source (ns).
        path: Name of the bus in messages and recordings.

    Attributes:
        fingertips: Fingertips by row.

    Raises:
        ParameterError: if a row is not from 0 to 7.
    """

    fingertip = Fingertip  # class of the fingertips

    def __init__(
        self,
        source: CellSource,
        rows: Mapping[int, int] = ONE_FINGERTIP,
        *,
        conversion: int = CONVERSION,
        now: Callable[[], int] = time_ns,
        path: str = VIRTUAL,
    ) -> None:
        if not set(rows) <= set(range(ROWS)):
            raise ParameterError("EmulatedI2cBus", "rows", list(rows), f"from 0 to {ROWS - 1}")
        self.fingertips = {
            row: self.fingertip(row, finger, source, conversion) for row, finger in rows.items()
        }
        self.path, self._now, self._open = path, now, False

    def open(self) -> "EmulatedI2cConnection":
        """Open the bus for one program.

        Raises:
            OSError: if it is already open.
        """
        if self._open:
            raise os_error(errno.EWOULDBLOCK)
        self._open = True
        return EmulatedI2cConnection(self)

    def close(self) -> None:
        """Close the bus, so that another program can open it."""
        self._open = False

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Send messages in one transfer; return the bytes read by each, empty for a write.

        Raises:
            OSError: if no device acknowledges an address.
        """
        return [self.send(message) for message in messages]

    def send(self, message: Message) -> bytes:
        """Send one message; return the bytes read."""
        return self._access(message) if message.address == BAROMETER else self._switch(message)

    def _access(self, message: Message) -> bytes:
        """Write to the connected barometers, or read from them."""
        barometers = [each for fingertip in self.fingertips.values() for each in fingertip.connected]
        if not barometers:
            raise os_error(errno.EREMOTEIO)
        now = self._now()
        if message.length is None:
            for barometer in barometers:
                barometer.write(message.data, now)
            return b""
        answers = [barometer.read(message.length, now) for barometer in barometers]
        return bytes(reduce(int.__and__, octets) for octets in zip(*answers, strict=True))

    def _switch(self, message: Message) -> bytes:
        """Connect or disconnect barometers; the ATtinys act on the address and never acknowledge data."""
        on = message.length is None
        acknowledged = [fingertip.switch(message.address, on=on) for fingertip in self.fingertips.values()]
        if message.data or not any(acknowledged):
            raise os_error(errno.EREMOTEIO)
        return bytes([RELEASED]) * (message.length or 0)


class EmulatedI2cConnection:
    """An open bus with the methods of `smbus2.SMBus` that `TakkTile` uses."""

    funcs = I2cFunc.SMBUS_QUICK

    def __init__(self, bus: EmulatedI2cBus) -> None:
        self._bus = bus

    def close(self) -> None:
        """Close the bus."""
        self._bus.close()

    def write_quick(self, i2c_addr: int, /) -> None:
        """Send an address with the write bit and no data."""
        self._bus.transfer([Message(i2c_addr)])

    def read_byte(self, i2c_addr: int, /) -> int:
        """Read one byte."""
        return self._bus.transfer([Message(i2c_addr, length=1)])[0][0]

    def write_byte(self, i2c_addr: int, value: int, /) -> None:
        """Write one byte."""
        self._bus.transfer([Message(i2c_addr, bytes([value]))])

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        """Read bytes from a register on."""
        set_pointer, read = Message(i2c_addr, bytes([register])), Message(i2c_addr, length=length)
        return list(self._bus.transfer([set_pointer, read])[-1])

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None:
        """Write bytes from a register on."""
        self._bus.transfer([Message(i2c_addr, bytes([register, *data]))])

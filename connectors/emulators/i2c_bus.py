"""An emulated I2C bus with TakkTile fingertips on it, to the byte, and the adapter that drives it.

Barometers that are connected at once answer together: each pulls the lines low, so their bytes come as the
logical AND. Faults are commanded while the bus runs; errors carry the numbers that Linux reports.
"""

import errno
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from threading import Event, RLock
from time import sleep, time_ns
from types import MappingProxyType
from typing import Final, NamedTuple

from connectors.emulators.i2c_barometer import BAROMETER, CONVERSION, Fingertip, Skin
from operators.errors import ParameterError

_ROWS: Final = range(8)
_ONE: Final = MappingProxyType({0: 0})
_IDLE: Final = 0xFF  # what is read while nobody pulls the lines low


class Message(NamedTuple):
    """One message of a transfer: bytes to an address, or from it."""

    address: int  # 7 bits
    data: bytes = b""  # to write
    length: int | None = None  # bytes to read; None: it is a write


@dataclass(frozen=True)
class Adapter:
    """What drives a bus, and what it refuses.

    Attributes:
        empty: Whether it sends messages without data, as SMBus's quick command is (errno 95 if not).
        chained: Whether it sends any messages in one transfer. If not, only the last may be a read
            (errno 95) or without data (errno 5).
        speed: Bits per second, to take as long as the wires would; None: no time at all.
    """

    empty: bool = True
    chained: bool = True
    speed: float | None = None


RASPBERRY_PI: Final = Adapter(chained=False)  # i2c-bcm2835, models 0 to 4
DESIGNWARE: Final = Adapter(empty=False)  # i2c-designware; i2c-omap of a BeagleBone alike


def fault(number: int) -> OSError:
    """The error that stands for an errno."""
    return OSError(number, os.strerror(number))


@dataclass
class _Fault:
    """What is to go wrong; see `I2cBus.fail`."""

    number: int
    address: int | None
    after: int
    times: int

    def strikes(self, address: int) -> bool:
        """Whether a message to an address, the next that this fault sees, is to fail."""
        if not self.times or self.address not in (None, address):
            return False
        if self.after:
            self.after -= 1
            return False
        self.times -= 1
        return True


class I2cBus:
    """A bus with its fingertips; any thread may use it and command its faults.

    Args:
        skin: What the fingertips feel, such as a `Lab`.
        rows: The skin's finger at each row (0 to 7) that is there.
        adapter: What drives it.
        conversion: Time that a conversion takes, ns.
        now: The host's clock, ns; that of a lab is its `now`.

    Attributes:
        fingertips: By row; what is wrong with a cell is commanded there.
        busy: Addresses that a kernel driver owns (errno 16).
        away: Whether the adapter has been taken away.
        lost: The errno that what was opened before it was taken away fails with.
        generation: How often it has been taken away.
        transfers: How many went over the wires.
        octets: How many bytes did, addresses included.

    Raises:
        ParameterError: if there can be no such row.
    """

    def __init__(
        self,
        skin: Skin,
        rows: Mapping[int, int] = _ONE,
        *,
        adapter: Adapter = RASPBERRY_PI,
        conversion: int = CONVERSION,
        now: Callable[[], int] = time_ns,
    ) -> None:
        if not set(rows) <= set(_ROWS):
            raise ParameterError("I2cBus", "rows", list(rows), "from 0 to 7")
        self.fingertips = {row: Fingertip(row, finger, skin, conversion) for row, finger in rows.items()}
        self.adapter = adapter
        self.busy = set[int]()
        self.away, self.lost = False, errno.ENODEV
        self.generation = self.transfers = self.octets = 0
        self._now, self._lock = now, RLock()  # faults may be commanded by the skin
        self._faults: list[_Fault] = []
        self._flowing = Event()
        self._flowing.set()

    def fail(self, number: int, *, address: int | None = None, after: int = 0, times: int = 1) -> None:
        """Let the next messages, or the next to one address, fail with an errno and without effect.

        Args:
            number: 121 is a NACK, 110 a time-out of the adapter, 5 an I/O error.
            address: That they go to; None: any.
            after: How many of them work before.
            times: How many of them fail.
        """
        with self._lock:
            self._faults.append(_Fault(number, address, after, times))

    def heal(self) -> None:
        """Let nothing fail any more that `fail` has asked for."""
        with self._lock:
            self._faults.clear()

    def wedge(self) -> None:
        """Hold the bus: who uses it is blocked until `release`."""
        self._flowing.clear()

    def release(self) -> None:
        """Let go of the bus: who was blocked is told of a time-out (errno 110)."""
        self._flowing.set()

    def unplug(self) -> None:
        """Pull the cable of all fingertips."""
        for fingertip in self.fingertips.values():
            fingertip.unplug()

    def plug(self) -> None:
        """Put it in again: the fingertips power up."""
        for fingertip in self.fingertips.values():
            fingertip.plug()

    def remove(self, number: int = errno.ENODEV) -> None:
        """Take the adapter away, as one on USB can be: what is open fails for good, with errno 19 or 6."""
        self.away, self.lost = True, number
        self.generation += 1

    def restore(self) -> None:
        """Put the adapter back, to be opened anew."""
        self.away = False

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Send messages in one go.

        Returns:
            What each of them read; nothing where it wrote.

        Raises:
            OSError: as Linux reports it.
        """
        if not self._flowing.is_set():
            self._flowing.wait()
            raise fault(errno.ETIMEDOUT)
        self._check(messages)
        with self._lock:
            self.transfers += 1
            return [self._send(message) for message in messages]

    def _check(self, messages: Sequence[Message]) -> None:
        """Refuse what the adapter cannot send."""
        empty = [not message.data and not message.length for message in messages]
        if any(empty) and not self.adapter.empty:
            raise fault(errno.EOPNOTSUPP)
        if not self.adapter.chained and any(message.length is not None for message in messages[:-1]):
            raise fault(errno.EOPNOTSUPP)
        if not self.adapter.chained and any(empty[:-1]):
            raise fault(errno.EIO)

    def _send(self, message: Message) -> bytes:
        for each in self._faults:
            if each.strikes(message.address):
                raise fault(each.number)
        if message.address == BAROMETER:
            return self._converse(message)
        return self._switch(message)

    def _converse(self, message: Message) -> bytes:
        """With the barometers that are connected."""
        barometers = [each for fingertip in self.fingertips.values() for each in fingertip.connected]
        if not barometers:
            self._spend(1)
            raise fault(errno.EREMOTEIO)
        now = self._now()
        if message.length is None:
            self._spend(1 + len(message.data))
            for barometer in barometers:
                barometer.write(message.data, now)
            return b""
        self._spend(1 + message.length)
        answers = [barometer.read(message.length, now) for barometer in barometers]
        return bytes(reduce(int.__and__, octets) for octets in zip(*answers, strict=True))

    def _switch(self, message: Message) -> bytes:
        """With the ATtinys: the address alone has its effect, data is not acknowledged."""
        on = message.length is None
        heard = [fingertip.switch(message.address, on=on) for fingertip in self.fingertips.values()]
        self._spend(1 + ((message.length or min(1, len(message.data))) if any(heard) else 0))
        if message.data or not any(heard):
            raise fault(errno.EREMOTEIO)
        return bytes([_IDLE]) * (message.length or 0)

    def _spend(self, octets: int) -> None:
        """Let so many bytes of nine bits each pass over the wires."""
        self.octets += octets
        if self.adapter.speed is not None:
            sleep(9 * octets / self.adapter.speed)

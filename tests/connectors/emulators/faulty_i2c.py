"""An emulated I2C bus with faults on command, and adapters that refuse what real ones refuse."""

import errno
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from threading import Event
from time import sleep, time_ns
from typing import Final, cast

from connectors.emulators.i2c_barometer import CONVERSION, Barometer, CellSource, Fingertip
from connectors.emulators.i2c_bus import ONE_FINGERTIP, EmulatedI2cBus, Message, os_error
from operators.batch import BAROMETERS

TURN: Final = 1024  # counts of the 10-bit converter


class Defect(Enum):
    """Defects of a barometer."""

    DEAD = auto()  # it does not answer
    STUCK = auto()  # it repeats what it converted last
    ZERO = auto()  # it converts everything to 0


class FaultyBarometer(Barometer):
    """A barometer with a defect, or whose pressure is `overload` counts above that of its source."""

    defect: Defect | None = None
    overload = 0

    def convert(self, now: int) -> bytes:
        if self.defect is Defect.STUCK:
            return bytes(self.registers[:4])
        if self.defect is Defect.ZERO:
            return bytes(4)
        data = super().convert(now)
        pressure = ((int.from_bytes(data[:2], "big") >> 6) - self.overload) % TURN
        return (pressure << 6).to_bytes(2, "big") + data[2:]


class FaultyFingertip(Fingertip):
    """A fingertip whose cable can be pulled."""

    barometer = FaultyBarometer
    plugged = True

    @property
    def barometers(self) -> list[FaultyBarometer]:
        return cast("list[FaultyBarometer]", self.cells)

    def unplug(self) -> None:
        self.plugged = False

    def plug(self) -> None:
        """Power up, with all barometers off."""
        self.plugged, self.on = True, [False] * BAROMETERS
        for barometer in self.cells:
            barometer.power_up()

    def switch(self, address: int, *, on: bool) -> bool:
        return self.plugged and super().switch(address, on=on)

    @property
    def connected(self) -> list[Barometer]:
        alive = [each for each in self.barometers if each.defect is not Defect.DEAD]
        return [each for each in super().connected if self.plugged and each in alive]


@dataclass(frozen=True)
class Adapter:
    """Capabilities of a bus adapter.

    Attributes:
        empty: It sends messages without data, as SMBus's quick command is (errno 95 if not).
        chained: It sends any messages in one transfer. If not, only the last may be a read (errno 95) or
            without data (errno 5).
        speed: Bits per second; None: transfers take no time.
    """

    empty: bool = True
    chained: bool = True
    speed: float | None = None


RASPBERRY_PI: Final = Adapter(chained=False)  # i2c-bcm2835, models 0 to 4
DESIGNWARE: Final = Adapter(empty=False)  # i2c-designware; i2c-omap of a BeagleBone alike


@dataclass
class Fault:
    """Messages that fail; see `FaultyI2cBus.fail`."""

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


class FaultyI2cBus(EmulatedI2cBus):
    """A bus whose faults any thread may command.

    Attributes:
        adapter: What drives it.
        busy: Addresses that a kernel driver owns (errno 16).
        away: The adapter has been taken away.
        lost: The errno with which connections opened before that fail.
        generation: How often the adapter has been taken away.
        transfers, octets: Transfers, and bytes that they sent, addresses included.
    """

    fingertip = FaultyFingertip

    def __init__(
        self,
        source: CellSource,
        rows: Mapping[int, int] = ONE_FINGERTIP,
        *,
        adapter: Adapter = RASPBERRY_PI,
        conversion: int = CONVERSION,
        now: Callable[[], int] = time_ns,
    ) -> None:
        super().__init__(source, rows, conversion=conversion, now=now)
        self.adapter = adapter
        self.busy = set[int]()
        self.away, self.lost = False, errno.ENODEV
        self.generation = self.transfers = self.octets = 0
        self._faults: list[Fault] = []
        self._flowing = Event()
        self._flowing.set()

    def tip(self, row: int) -> FaultyFingertip:
        """Return the fingertip of a row."""
        return cast("FaultyFingertip", self.fingertips[row])

    def cell(self, row: int, column: int) -> FaultyBarometer:
        """Return one barometer."""
        return self.tip(row).barometers[column]

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
        for row in self.fingertips:
            self.tip(row).unplug()

    def plug(self) -> None:
        """Put it in again: the fingertips power up."""
        for row in self.fingertips:
            self.tip(row).plug()

    def remove(self, number: int = errno.ENODEV) -> None:
        """Take the adapter away, as one on USB can be: open connections fail for good, with errno 19 or 6."""
        self.away, self.lost = True, number
        self.generation += 1

    def restore(self) -> None:
        """Put the adapter back, to be opened again."""
        self.away = False

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        if not self._flowing.is_set():
            self._flowing.wait()
            raise os_error(errno.ETIMEDOUT)
        self._check(messages)
        self.transfers += 1
        return super().transfer(messages)

    def send(self, message: Message) -> bytes:
        for fault in self._faults:
            if fault.strikes(message.address):
                raise os_error(fault.number)
        octets = 1  # the address
        try:
            answer = super().send(message)
            octets += len(message.data) or len(answer)
            return answer
        finally:
            self.octets += octets
            if self.adapter.speed is not None:
                sleep(9 * octets / self.adapter.speed)  # 8 bits and an acknowledgement each

    def _check(self, messages: Sequence[Message]) -> None:
        """Refuse what the adapter cannot send."""
        empty = [not message.data and not message.length for message in messages]
        if any(empty) and not self.adapter.empty:
            raise os_error(errno.EOPNOTSUPP)
        if not self.adapter.chained and any(message.length is not None for message in messages[:-1]):
            raise os_error(errno.EOPNOTSUPP)
        if not self.adapter.chained and any(empty[:-1]):
            raise os_error(errno.EIO)

"""An emulated I2C bus as a device file, for an unmodified smbus2.

smbus2 asks the operating system three things: ``os.open``, ``fcntl.ioctl`` and ``os.close``. While a bus is
served, these calls of smbus2, and of nobody else, reach the bus where they are about its path. All of smbus2
stays real, down to the structure that it hands to the kernel, which is declared here once more, after Linux's
``i2c-dev.h``; messages are made of it as ``i2c-core-smbus.c`` does.
"""

import errno
import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from ctypes import POINTER, Structure, c_uint8, c_uint32, c_ulong, string_at
from typing import ClassVar, Final, Protocol, TypeAlias

import smbus2.smbus2

from tests.emulators.i2c_bus import EmulatedI2cBus, Message, os_error

_SLAVE, _FUNCTIONS, _SMBUS = 0x0703, 0x0705, 0x0720  # requests
_QUICK, _BYTE, _BLOCK = 0, 1, 8  # sizes of SMBus transactions
_READ: Final = 1
_LONGEST: Final = 32  # bytes of a block
_EMULATED: Final = 0x0CFF0009  # functions of an adapter that sends messages, block data excepted
_EMULATED_QUICK: Final = 0x00010000  # among them

_Argument: TypeAlias = int | Structure | c_ulong
_Control: TypeAlias = Callable[[int, int, _Argument], int]


class _System(Protocol):
    """Functions that smbus2 uses of the module ``os``."""

    def open(self, path: str, flags: int, /) -> int: ...
    def close(self, descriptor: int, /) -> None: ...


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
    """Let smbus2 find a bus at a path, in all threads of this process, for as long as the block lasts.

    Several may be served at paths of their own. When the block ends whoever is blocked by a wedged bus is
    released, and what is still open has become useless.
    """
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
    """Stands for the module ``os`` and the function ``ioctl`` in smbus2."""

    O_RDWR = os.O_RDWR

    def __init__(
        self, bus: EmulatedI2cBus, path: str, backing: int, system: _System, control: _Control
    ) -> None:
        self._bus, self._path, self._backing = bus, path, backing
        self._system, self._control = system, control  # that smbus2 had before
        self._handles: dict[int, _Handle] = {}

    def open(self, path: str, flags: int) -> int:
        """Return a new descriptor, which smbus2 may lock and close as any other."""
        if path != self._path:
            return self._system.open(path, flags)
        if self._bus.away:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        descriptor = os.open(f"/proc/self/fd/{self._backing}", flags)
        self._handles[descriptor] = _Handle(self._bus)
        return descriptor

    def close(self, descriptor: int) -> None:
        self._handles.pop(descriptor, None)
        self._system.close(descriptor)

    def ioctl(self, descriptor: int, request: int, argument: _Argument = 0) -> int:
        if (handle := self._handles.get(descriptor)) is None:
            return self._control(descriptor, request, argument)
        handle.ioctl(request, argument)
        return 0


class _Handle:
    """The bus as one program that has opened it sees it."""

    def __init__(self, bus: EmulatedI2cBus) -> None:
        self._bus, self._generation, self._address = bus, bus.generation, 0

    def ioctl(self, request: int, argument: _Argument) -> None:
        """Execute one request of ``i2c-dev.h``."""
        if self._generation != self._bus.generation:
            raise os_error(self._bus.lost)
        if request == _SLAVE and isinstance(argument, int):
            if argument in self._bus.busy:
                raise os_error(errno.EBUSY)
            self._address = argument
        elif request == _FUNCTIONS and not isinstance(argument, int):
            quick = 0 if self._bus.adapter.empty else _EMULATED_QUICK
            c_ulong.from_buffer(argument).value = _EMULATED & ~quick
        elif request == _SMBUS and not isinstance(argument, int):
            self._transact(_Transaction.from_buffer(argument))
        else:
            raise os_error(errno.ENOTTY)

    def _transact(self, asked: _Transaction) -> None:
        """Execute an SMBus transaction, as messages; a block begins with its length."""
        reads, command = asked.read_write == _READ, bytes([asked.command])
        if asked.size not in (_QUICK, _BYTE, _BLOCK):
            raise os_error(errno.EOPNOTSUPP)
        if asked.size == _QUICK:
            messages = [Message(self._address, length=0 if reads else None)]
        elif asked.size == _BYTE:
            messages = [Message(self._address, length=1) if reads else Message(self._address, command)]
        elif reads:
            messages = [Message(self._address, command), Message(self._address, length=asked.data[0])]
        else:
            block = string_at(asked.data, _LONGEST + 2)
            messages = [Message(self._address, command + block[1 : 1 + block[0]])]
        start = 1 if asked.size == _BLOCK else 0
        for octet, value in enumerate(self._bus.transfer(messages)[-1]):
            asked.data[start + octet] = value

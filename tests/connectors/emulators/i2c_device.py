"""An emulated I2C bus as a device file, for an unmodified smbus2.

smbus2 asks the operating system three things: ``os.open``, ``fcntl.ioctl`` and ``os.close``. While a bus is
served, these calls of smbus2, and of nobody else, reach the bus where they are about its path. All of smbus2
stays real, down to the structures that it hands to the kernel: they are declared here once more, after
Linux's ``i2c-dev.h`` and ``i2c.h``, and messages are made of them as ``i2c-core-smbus.c`` does.
"""

import errno
import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from ctypes import POINTER, Structure, c_uint8, c_uint16, c_uint32, c_ulong, memmove, string_at
from typing import ClassVar, Final, Protocol, TypeAlias

import smbus2.smbus2

from connectors.emulators.i2c_bus import Message, os_error
from tests.connectors.emulators.faulty_i2c import FaultyI2cBus

_RETRIES, _TIMEOUT, _SLAVE, _FUNCTIONS = 0x0701, 0x0702, 0x0703, 0x0705
_SLAVE_FORCE, _TRANSFER, _CHECKSUM, _SMBUS = 0x0706, 0x0707, 0x0708, 0x0720
_QUICK, _BYTE, _BYTE_DATA, _WORD_DATA, _CALL, _BLOCK = 0, 1, 2, 3, 4, 8  # sizes of SMBus transactions
_READ: Final = 1  # of a transaction, and of a message
_HIGHEST: Final = 0x7F  # address
_LONGEST: Final = 32  # bytes of a block
_MOST: Final = 42  # messages of a transfer
_EMULATED: Final = 0x0CFF0009  # functions of an adapter that sends messages, block data excepted
_EMULATED_QUICK: Final = 0x00010000  # among them

_Argument: TypeAlias = int | Structure | c_ulong
_Control: TypeAlias = Callable[[int, int, _Argument], int]


class _System(Protocol):
    """Functions that smbus2 uses of the module ``os``."""

    def open(self, path: str, flags: int, /) -> int: ...
    def close(self, descriptor: int, /) -> None: ...


class _Transaction(Structure):
    """struct i2c_smbus_ioctl_data; the union it points to holds a byte, a word or a block: here its bytes."""

    _fields_: ClassVar = [
        ("read_write", c_uint8),
        ("command", c_uint8),
        ("size", c_uint32),
        ("data", POINTER(c_uint8)),
    ]


class _Message(Structure):
    """struct i2c_msg."""

    _fields_: ClassVar = [
        ("addr", c_uint16),
        ("flags", c_uint16),
        ("len", c_uint16),
        ("buf", POINTER(c_uint8)),
    ]


class _Transfer(Structure):
    """struct i2c_rdwr_ioctl_data."""

    _fields_: ClassVar = [("msgs", POINTER(_Message)), ("nmsgs", c_uint32)]


@contextmanager
def served(bus: FaultyI2cBus, path: str) -> Generator[FaultyI2cBus]:
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
        self, bus: FaultyI2cBus, path: str, backing: int, system: _System, control: _Control
    ) -> None:
        self._bus, self._path, self._backing = bus, path, backing
        self._system, self._control = system, control  # that smbus2 had before
        self._handles: dict[int, _Handle] = {}

    def open(self, path: str, flags: int) -> int:
        """A descriptor of one's own, which smbus2 may lock and close as any other."""
        if path != self._path:
            return self._system.open(path, flags)
        if self._bus.away:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        descriptor = os.open(f"/proc/self/fd/{self._backing}", flags)
        self._handles[descriptor] = _Handle(self._bus)
        return descriptor

    def close(self, descriptor: int) -> None:
        """Close it."""
        self._handles.pop(descriptor, None)
        self._system.close(descriptor)

    def ioctl(self, descriptor: int, request: int, argument: _Argument = 0) -> int:
        """Answer an ioctl of smbus2."""
        if (handle := self._handles.get(descriptor)) is None:
            return self._control(descriptor, request, argument)
        handle.ioctl(request, argument)
        return 0


class _Handle:
    """The bus as one who has opened it sees it."""

    def __init__(self, bus: FaultyI2cBus) -> None:
        self._bus, self._generation, self._address = bus, bus.generation, 0

    def ioctl(self, request: int, argument: _Argument) -> None:
        """One request of ``i2c-dev.h``."""
        if self._generation != self._bus.generation:
            raise os_error(self._bus.lost)
        if isinstance(argument, int):
            self._set(request, argument)
        elif request == _FUNCTIONS:
            quick = 0 if self._bus.adapter.empty else _EMULATED_QUICK
            c_ulong.from_buffer(argument).value = _EMULATED & ~quick
        elif request == _SMBUS:
            self._transact(_Transaction.from_buffer(argument))
        elif request == _TRANSFER:
            self._transfer(_Transfer.from_buffer(argument))
        else:
            raise os_error(errno.ENOTTY)

    def _set(self, request: int, value: int) -> None:
        """The address to talk to, or how; time limits and the like change nothing here."""
        if request in (_SLAVE, _SLAVE_FORCE):
            if not 0 <= value <= _HIGHEST:
                raise os_error(errno.EINVAL)
            if request == _SLAVE and value in self._bus.busy:
                raise os_error(errno.EBUSY)
            self._address = value
        elif request not in (_RETRIES, _TIMEOUT, _CHECKSUM):
            raise os_error(errno.ENOTTY)

    def _transact(self, asked: _Transaction) -> None:
        """An SMBus transaction, as messages."""
        address, reads, size = self._address, asked.read_write == _READ, asked.size
        command, data = bytes([asked.command]), string_at(asked.data, _LONGEST + 2)
        if size not in (_QUICK, _BYTE, _BYTE_DATA, _WORD_DATA, _CALL, _BLOCK):
            raise os_error(errno.EOPNOTSUPP)
        if size == _BLOCK and data[0] > _LONGEST:
            raise os_error(errno.EINVAL)
        length = {_QUICK: 0, _BYTE: 1, _BYTE_DATA: 1, _WORD_DATA: 2, _CALL: 2, _BLOCK: data[0]}[size]
        start = 1 if size == _BLOCK else 0  # a block begins with its length
        if size == _QUICK or (size == _BYTE and reads):
            messages = [Message(address, length=length if reads else None)]
        elif size == _BYTE:
            messages = [Message(address, command)]
        elif size == _CALL:
            messages = [Message(address, command + data[:2]), Message(address, length=2)]
        elif reads:
            messages = [Message(address, command), Message(address, length=length)]
        else:
            messages = [Message(address, command + data[start : start + length])]
        for octet, value in enumerate(self._bus.transfer(messages)[-1]):
            asked.data[start + octet] = value

    def _transfer(self, asked: _Transfer) -> None:
        """Messages in one go."""
        if not 0 < asked.nmsgs <= _MOST:
            raise os_error(errno.EINVAL)
        wanted = asked.msgs[: asked.nmsgs]
        messages = [
            Message(each.addr, length=each.len)
            if each.flags & _READ
            else Message(each.addr, string_at(each.buf, each.len))
            for each in wanted
        ]
        for each, octets in zip(wanted, self._bus.transfer(messages), strict=True):
            memmove(each.buf, octets, len(octets))

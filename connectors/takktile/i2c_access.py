"""I2C bus: the interface that `Scanner` uses, and its implementation for Linux with smbus2."""

import fcntl
from collections.abc import Sequence
from typing import Protocol

from smbus2 import SMBus


class I2cConnection(Protocol):
    """An open bus: the methods of `smbus2.SMBus` that `Scanner` uses. They raise OSError."""

    @property
    def funcs(self) -> int: ...  # noqa: D102 - bits of `smbus2.I2cFunc` that the adapter supports
    def write_quick(self, i2c_addr: int, /) -> None: ...  # noqa: D102
    def read_byte(self, i2c_addr: int, /) -> int: ...  # noqa: D102
    def write_byte(self, i2c_addr: int, value: int, /) -> None: ...  # noqa: D102
    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]: ...  # noqa: D102
    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


class I2cBus(Protocol):
    """A bus that can be opened: `LinuxI2cBus`, or the emulated bus of `connectors.emulators.i2c_bus`."""

    @property
    def path(self) -> str:
        """Name of the bus in messages and recordings."""
        ...

    def open(self) -> I2cConnection:
        """Open the bus for one program.

        Raises:
            OSError: if the bus does not exist, cannot be accessed or is in use.
        """
        ...


class LinuxI2cBus:
    """A bus of the Linux kernel, such as /dev/i2c-1."""

    def __init__(self, path: str) -> None:
        self.path = path

    def open(self) -> SMBus:
        """Open the bus and lock it against other programs that scan it.

        Raises:
            OSError: if the bus does not exist, cannot be accessed or is locked.
        """
        bus = SMBus()
        try:
            bus.open(self.path)
            assert bus.fd is not None
            fcntl.flock(bus.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BaseException:
            bus.close()
            raise
        return bus

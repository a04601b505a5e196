"""Packages and recipes of UR's Real-Time Data Exchange (RTDE), version 2, as bytes. No I/O.

A connection carries packages: uint16 size (including these three bytes), uint8 kind, payload; all numbers are
big-endian. A client requests a *recipe* of outputs by name, receives their types, and then their values at
the requested rate.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

from collections.abc import Iterator, Sequence
from enum import IntEnum
from struct import Struct
from typing import Final, NamedTuple, Self

from operators.errors import SlipflowError

PORT: Final = 30004
PROTOCOL: Final = 2  # version
LARGEST: Final = 8192  # bytes of a package, twice the size of all variables of a controller
_REFUSALS: Final = {"NOT_FOUND", "IN_USE"}  # instead of a type
_HEADER: Final = Struct(">HB")
_VERSION: Final = Struct(">4I")
_RATE: Final = Struct(">d")


class RtdeError(SlipflowError):
    """Violation of the protocol, or refusal of a request, by a peer."""


class Kind(IntEnum):
    """Kind of a package, the same for a request and its answer."""

    PROTOCOL = ord("V")  # uint16 version -> bool
    CONTROLLER = ord("v")  # -> uint32 major, minor, bugfix, build
    TEXT = ord("M")  # from the controller: uint8 length, message, uint8 length, source, uint8 level
    DATA = ord("U")  # from the controller: uint8 number of the recipe, packed values
    OUTPUTS = ord("O")  # double rate, names -> uint8 number of the recipe, types
    START = ord("S")  # -> bool


class Package(NamedTuple):
    """A package without its header."""

    kind: int
    payload: bytes


def pack(kind: int, payload: bytes = b"") -> bytes:
    r"""Return a package as bytes.

    >>> pack(Kind.PROTOCOL, b"\0\2").hex(" ")
    '00 05 56 00 02'
    """
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


class Packages:
    """Splitter of a byte stream, received in chunks of any size, into packages."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[Package]:
        """Yield the packages that `data` completes; the caller must exhaust the iterator.

        Raises:
            RtdeError: on an invalid size, after which no package boundary can be found.
        """
        data, begin = self._rest + data, 0
        try:
            while len(data) - begin >= _HEADER.size:
                size, kind = _HEADER.unpack_from(data, begin)
                if not _HEADER.size <= size <= LARGEST:
                    raise RtdeError(f"a package of {size} bytes, must be {_HEADER.size} to {LARGEST}")
                if len(data) - begin < size:
                    break
                begin += size
                yield Package(kind, data[begin - size + _HEADER.size : begin])
        finally:
            self._rest = data[begin:]


def names(payload: bytes) -> tuple[str, ...]:
    """Parse names or types separated by commas; a trailing comma is allowed.

    >>> names(b"timestamp,actual_q,")
    ('timestamp', 'actual_q')
    """
    return tuple(name.strip() for name in payload.decode("ascii", "replace").split(",") if name.strip())


def granted_types(asked: Sequence[str], payload: bytes) -> tuple[int, tuple[str, ...]]:
    r"""Return the number of the recipe and the types that a controller's answer grants.

    Raises:
        RtdeError: if the controller refuses, naming the refused fields.

    >>> granted_types(["timestamp", "actual_q"], b"\1DOUBLE,VECTOR6D")
    (1, ('DOUBLE', 'VECTOR6D'))
    """
    number, types = payload[:1], names(payload[1:])
    refusals = [f"{name} {kind}" for name, kind in zip(asked, types, strict=False) if kind in _REFUSALS]
    if refusals:
        raise RtdeError(f"the controller refused {', '.join(refusals)}")
    if number in (b"", b"\0"):
        raise RtdeError(f"the controller refused {', '.join(asked)}: does another program use them?")
    if len(types) != len(asked):
        raise RtdeError(f"{len(asked)} fields cannot have the types {', '.join(types)}")
    return number[0], types


class Version(NamedTuple):
    """Software version of a controller."""

    major: int  # 3: CB3, 125 Hz; 5: e-Series, 500 Hz
    minor: int
    bugfix: int
    build: int

    @classmethod
    def read(cls, payload: bytes) -> Self:
        """Parse the version in a controller's answer.

        Raises:
            RtdeError: if the answer has another size.
        """
        if len(payload) != _VERSION.size:
            raise RtdeError(f"the controller's version has {len(payload)} bytes, must have {_VERSION.size}")
        return cls(*_VERSION.unpack(payload))

    def __str__(self) -> str:
        return ".".join(map(str, self))


def ask_outputs(rate: float, outputs: Sequence[str]) -> bytes:
    """Return the payload of a request for outputs at a rate (Hz)."""
    return _RATE.pack(rate) + ",".join(outputs).encode()


def text(payload: bytes) -> str:
    r"""Return the message and the source of a text package.

    >>> text(b"\5hello\4RTDE\1")
    'hello (RTDE)'
    """
    message = payload[1 : 1 + payload[0]] if payload else b""
    source = payload[2 + len(message) : -1]
    read = f"{message.decode('utf-8', 'replace')} ({source.decode('utf-8', 'replace')})"
    return "".join(each if each.isprintable() else " " for each in read)

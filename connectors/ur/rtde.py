"""Packages and recipes of UR's Real-Time Data Exchange (RTDE), version 2, as bytes. No I/O.

A connection carries packages: uint16 size (including these three bytes), uint8 kind, payload; all numbers are
big-endian. A client requests a *recipe* of outputs by name, receives their types, and then their values at
the requested rate. It may also request recipes of inputs, and send their values.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from struct import Struct, error
from types import MappingProxyType
from typing import Final, NamedTuple, Self, TypeAlias

from operators.errors import SlipflowError

Value: TypeAlias = float | tuple[float, ...]  # includes integers and flags

PORT: Final = 30004
PROTOCOL: Final = 2  # version
LARGEST: Final = 8192  # bytes of a package, twice the size of all variables of a controller
FORMATS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "BOOL": "?",
        "UINT8": "B",
        "UINT32": "I",
        "UINT64": "Q",
        "INT32": "i",
        "DOUBLE": "d",
        "VECTOR3D": "3d",
        "VECTOR6D": "6d",
        "VECTOR6INT32": "6i",
        "VECTOR6UINT32": "6I",
    }
)

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
    DATA = ord("U")  # in both directions: uint8 number of the recipe, packed values
    OUTPUTS = ord("O")  # double rate, names -> uint8 number of the recipe, types
    INPUTS = ord("I")  # names -> uint8 number of the recipe, types
    START = ord("S")  # -> bool
    PAUSE = ord("P")  # -> bool


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

    def __init__(self, largest: int = LARGEST) -> None:
        self._largest, self._rest = largest, b""

    def feed(self, data: bytes) -> Iterator[Package]:
        """Yield the packages that `data` completes; the caller must exhaust the iterator.

        Raises:
            RtdeError: on an invalid size, after which no package boundary can be found.
        """
        data, begin = self._rest + data, 0
        try:
            while len(data) - begin >= _HEADER.size:
                size, kind = _HEADER.unpack_from(data, begin)
                if not _HEADER.size <= size <= self._largest:
                    raise RtdeError(f"a package of {size} bytes, must be {_HEADER.size} to {self._largest}")
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


@dataclass(frozen=True)
class Recipe:
    """Fields of a data package, in order.

    Raises:
        RtdeError: on an unknown type.

    >>> recipe = Recipe(1, ("timestamp", "actual_q"), ("DOUBLE", "VECTOR6D"))
    >>> recipe.unpack(recipe.pack((0.5, (1, 2, 3, 4, 5, 6))))
    (0.5, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    """

    number: int  # 1..255
    names: tuple[str, ...]
    types: tuple[str, ...]
    _struct: Struct = field(init=False, repr=False, compare=False)
    _widths: tuple[int, ...] = field(init=False, repr=False, compare=False)  # numbers per field

    def __post_init__(self) -> None:
        unknown = [kind for kind in self.types if kind not in FORMATS]
        if unknown or len(self.types) != len(self.names):
            raise RtdeError(f"{len(self.names)} fields cannot have the types {', '.join(self.types)}")
        formats = [FORMATS[kind] for kind in self.types]
        object.__setattr__(self, "_struct", Struct(">B" + "".join(formats)))
        object.__setattr__(self, "_widths", tuple(int(each[:-1] or 1) for each in formats))

    @classmethod
    def granted(cls, names_asked: Sequence[str], payload: bytes) -> Self:
        """Return the recipe that a controller's answer grants.

        Raises:
            RtdeError: if the controller refuses, naming the refused fields.
        """
        number, types = payload[:1], names(payload[1:])
        pairs = zip(names_asked, types, strict=False)
        refused = [f"{name} {reason}" for name, reason in pairs if reason not in FORMATS]
        if refused:
            raise RtdeError(f"the controller refused {', '.join(refused)}")
        if number in (b"", b"\0"):
            wanted = ", ".join(names_asked)
            raise RtdeError(f"the controller refused {wanted}: does another program use them?")
        return cls(number[0], tuple(names_asked), types)

    @property
    def size(self) -> int:
        """Size of the payload in bytes."""
        return self._struct.size

    @property
    def answer(self) -> bytes:
        """Payload of the answer that grants the recipe."""
        return bytes([self.number]) + ",".join(self.types).encode()

    def pack(self, values: Sequence[Value]) -> bytes:
        """Pack values into a payload.

        Raises:
            RtdeError: if a value has another type or is out of range.
        """
        flat: list[float] = []
        for value in values:
            flat.extend(value if isinstance(value, tuple) else (value,))
        try:
            return self._struct.pack(self.number, *flat)
        except error as reason:
            raise RtdeError(f"{self.names} cannot be {tuple(values)}: {reason}") from reason

    def unpack(self, payload: bytes) -> tuple[Value, ...]:
        """Unpack the values of a payload.

        Raises:
            RtdeError: if the payload has another recipe number or size.
        """
        self.check(payload)
        flat, begin, values = self._struct.unpack(payload), 1, list[Value]()
        for width in self._widths:
            values.append(flat[begin] if width == 1 else flat[begin : begin + width])
            begin += width
        return tuple(values)

    def check(self, payload: bytes) -> None:
        """Check that a payload belongs to this recipe.

        Raises:
            RtdeError: if the payload has another recipe number or size.
        """
        if payload[:1] != bytes([self.number]) or len(payload) != self.size:
            found = f"{len(payload)} bytes for recipe {payload[:1].hex() or 'none'}"
            raise RtdeError(f"data of {found}, not {self.size} for {self.number:02x}")


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

    @property
    def payload(self) -> bytes:
        """Payload of the answer to a client."""
        return _VERSION.pack(*self)

    def __str__(self) -> str:
        return ".".join(map(str, self))


def ask_outputs(rate: float, outputs: Sequence[str]) -> bytes:
    """Return the payload of a request for outputs at a rate (Hz)."""
    return _RATE.pack(rate) + ",".join(outputs).encode()


def outputs_asked(payload: bytes) -> tuple[float, tuple[str, ...]]:
    """Parse a client's request for outputs into rate (Hz) and names.

    Raises:
        RtdeError: if the payload is too short.
    """
    if len(payload) < _RATE.size:
        raise RtdeError(f"a request for outputs of {len(payload)} bytes, must be at least {_RATE.size}")
    return _RATE.unpack_from(payload)[0], names(payload[_RATE.size :])


def text(payload: bytes) -> str:
    r"""Return the message and the source of a text package.

    >>> text(b"\5hello\4RTDE\1")
    'hello (RTDE)'
    """
    length = payload[0] if payload else 0
    message, rest = payload[1 : 1 + length], payload[1 + length :]
    source = rest[1 : 1 + rest[0]] if rest else b""
    read = f"{message.decode('utf-8', 'replace')} ({source.decode('utf-8', 'replace')})"
    return "".join(each if each.isprintable() else " " for each in read)

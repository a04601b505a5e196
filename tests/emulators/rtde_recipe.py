"""Recipes of RTDE as a controller has them: requests of clients, and packed values."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from struct import Struct, error
from types import MappingProxyType
from typing import Final, NamedTuple, TypeAlias

from connectors.ur.rtde import LARGEST, RtdeError, Version

Value: TypeAlias = float | tuple[float, ...]  # includes integers and flags

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
HEADER: Final = Struct(">HB")
_RATE: Final = Struct(">d")


class Package(NamedTuple):
    """A package without its header."""

    kind: int
    payload: bytes


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
            while len(data) - begin >= HEADER.size:
                size, kind = HEADER.unpack_from(data, begin)
                if not HEADER.size <= size <= LARGEST:
                    raise RtdeError(f"a package of {size} bytes, must be {HEADER.size} to {LARGEST}")
                if len(data) - begin < size:
                    break
                begin += size
                yield Package(kind, data[begin - size + HEADER.size : begin])
        finally:
            self._rest = data[begin:]


def names(payload: bytes) -> tuple[str, ...]:
    """Parse names or types separated by commas; a trailing comma is allowed.

    >>> names(b"timestamp,actual_q,")
    ('timestamp', 'actual_q')
    """
    return tuple(name.strip() for name in payload.decode("ascii", "replace").split(",") if name.strip())


class Request(IntEnum):
    """Requests that our client does not make."""

    INPUTS = ord("I")  # names -> uint8 number of the recipe, types
    PAUSE = ord("P")  # -> bool


@dataclass(frozen=True)
class Recipe:
    """Fields of a data package, in order.

    >>> recipe = Recipe(1, ("timestamp", "actual_q"), ("DOUBLE", "VECTOR6D"))
    >>> recipe.unpack(recipe.pack((0.5, (1, 2, 3, 4, 5, 6))))
    (0.5, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    """

    number: int  # 1..255
    names: tuple[str, ...]
    types: tuple[str, ...]
    _struct: Struct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        formats = [FORMATS[kind] for kind in self.types]
        object.__setattr__(self, "_struct", Struct(">B" + "".join(formats)))

    @property
    def answer(self) -> bytes:
        """Payload of the answer that grants the recipe."""
        return bytes([self.number]) + ",".join(self.types).encode()

    def pack(self, values: Sequence[Value]) -> bytes:
        """Pack values into a payload."""
        flat: list[float] = []
        for value in values:
            flat.extend(value if isinstance(value, tuple) else (value,))
        return self._struct.pack(self.number, *flat)

    def unpack(self, payload: bytes) -> tuple[Value, ...]:
        """Unpack the values of a payload.

        Raises:
            RtdeError: if the payload has another size.
        """
        try:
            flat = self._struct.unpack(payload)[1:]
        except error as reason:
            raise RtdeError(f"data for recipe {self.number}: {reason}") from reason
        values, begin = list[Value](), 0
        for kind in self.types:
            width = int(FORMATS[kind][:-1] or 1)
            values.append(flat[begin] if width == 1 else flat[begin : begin + width])
            begin += width
        return tuple(values)


def version_payload(version: Version) -> bytes:
    """Return the payload of the answer with a controller's version."""
    return Struct(">4I").pack(*version)


def outputs_asked(payload: bytes) -> tuple[float, tuple[str, ...]]:
    """Parse a client's request for outputs into rate (Hz) and names.

    Raises:
        RtdeError: if the payload is too short.
    """
    if len(payload) < _RATE.size:
        raise RtdeError(f"a request for outputs of {len(payload)} bytes, must be at least {_RATE.size}")
    return _RATE.unpack_from(payload)[0], names(payload[_RATE.size :])

"""Recipes of RTDE as a controller has them: requests of clients, and packed values."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from struct import Struct
from types import MappingProxyType
from typing import Final, TypeAlias

from connectors.ur.rtde import Version

Value: TypeAlias = float | tuple[float, ...]  # includes integers

FORMATS: Final = MappingProxyType({"UINT32": "I", "INT32": "i", "DOUBLE": "d", "VECTOR6D": "6d"})
HEADER: Final = Struct(">HB")  # size and kind
_RATE: Final = Struct(">d")


def names(payload: bytes) -> tuple[str, ...]:
    """Parse names or types separated by commas; a trailing comma is allowed.

    >>> names(b"timestamp,actual_q,")
    ('timestamp', 'actual_q')
    """
    return tuple(name.strip() for name in payload.decode("ascii", "replace").split(",") if name.strip())


class Request(IntEnum):
    """Requests that our client does not make."""

    INPUTS = ord("I")  # names -> uint8 number of the recipe, types
    PAUSE = ord("P")  # -> bool; not emulated


@dataclass(frozen=True)
class Recipe:
    """Fields of a data package, in order.

    >>> recipe = Recipe(1, ("timestamp", "actual_q"), ("DOUBLE", "VECTOR6D"))
    >>> recipe.unpack(recipe.pack((0.5, (1, 2, 3, 4, 5, 6))))["timestamp"]
    0.5
    """

    number: int  # 1..255
    names: tuple[str, ...]
    types: tuple[str, ...]

    @cached_property
    def row(self) -> Struct:
        """Layout of a package."""
        return Struct(">B" + "".join(FORMATS[kind] for kind in self.types))

    @property
    def answer(self) -> bytes:
        """Payload of the answer that grants the recipe."""
        return bytes([self.number]) + ",".join(self.types).encode()

    def pack(self, values: Sequence[Value]) -> bytes:
        """Pack values into a payload."""
        flat: list[float] = []
        for value in values:
            flat.extend(value if isinstance(value, tuple) else (value,))
        return self.row.pack(self.number, *flat)

    def unpack(self, payload: bytes) -> dict[str, float]:
        """Unpack the values of a payload by name; of a vector, the first one."""
        flat, found, begin = self.row.unpack(payload)[1:], dict[str, float](), 0
        for name, kind in zip(self.names, self.types, strict=True):
            found[name] = flat[begin]
            begin += int(FORMATS[kind][:-1] or 1)
        return found


def version_payload(version: Version) -> bytes:
    """Return the payload of the answer with a controller's version."""
    return Struct(">4I").pack(*version)


def outputs_asked(payload: bytes) -> tuple[float, tuple[str, ...]]:
    """Parse a client's request for outputs into rate (Hz) and names."""
    return _RATE.unpack_from(payload)[0], names(payload[_RATE.size :])

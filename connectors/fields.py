"""Typed access to the fields of a JSON document."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NoReturn, TypeVar

from operators.errors import InputError
from operators.ports import Json

T = TypeVar("T")

INT64 = 2**63 - 1
MESSAGE_MAX = 64 * 1024  # bytes


@dataclass(frozen=True, slots=True)
class Fields:
    """A JSON object with typed access to its fields; a missing or invalid field raises an InputError.

    >>> document = Fields.parse(b'{"seq": 7}', "message")
    >>> document.integer("seq")
    7
    >>> document.text("epoch")
    Traceback (most recent call last):
    operators.errors.InputError: message: epoch is missing, must be printable text
    """

    values: Mapping[str, Json]
    where: str  # name of the message or file in errors
    path: str = ""  # path of the object within the document

    @classmethod
    def parse(cls, payload: bytes, where: str, *, largest: int = MESSAGE_MAX) -> "Fields":
        """Parse a JSON document.

        Raises:
            InputError: naming `where`, if it is larger than `largest` bytes or is not a JSON object.
        """
        if len(payload) > largest:
            raise InputError(where, f"is {len(payload)} bytes long; the limit is {largest}")
        try:
            document: Json = json.loads(payload, parse_constant=_refuse)
        except (ValueError, RecursionError) as error:
            raise InputError(where, f"is not JSON: {error}") from None
        return cls({"": document}, where).object("")

    def fail(self, name: str, must_be: str) -> NoReturn:
        """Reject a field.

        Raises:
            InputError: always, naming the field.
        """
        found = f"is {self.values[name]!r:.60}" if name in self.values else "is missing"
        raise InputError(self.where, f"{self.path}{name} {found}, must be {must_be}".lstrip())

    def expect(self, name: str, value: str) -> None:
        """Require that a field has this value."""
        if self.values.get(name) != value:
            self.fail(name, repr(value))

    def text(self, name: str) -> str:
        """Return a field of printable text."""
        value = self.values.get(name)
        if not isinstance(value, str) or not value.isprintable():
            self.fail(name, "printable text")
        return value

    def number(self, name: str, least: float = -INT64, greatest: float = INT64) -> float:
        """Return a field with a finite number from `least` to `greatest`."""
        value = self.values.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= INT64:
            self.fail(name, "a number")
        if not least <= value <= greatest:
            self.fail(name, f"from {least:g} to {greatest:g}")
        return float(value)

    def fraction(self, name: str) -> float:
        """Return a field with a number from 0 to 1."""
        return self.number(name, 0, 1)

    def integer(self, name: str, least: int = 1, greatest: int = INT64) -> int:
        """Return a field with an integer from `least` to `greatest`."""
        value = self.values.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= greatest:
            self.fail(name, f"an integer from {least} to {greatest}")
        return value

    def nullable(self, read: Callable[[str], T], name: str) -> T | None:
        """Return a field through `read`, or None for null."""
        return None if self.values.get(name, 0) is None else read(name)

    def object(self, name: str) -> "Fields":
        """Return a field with an object."""
        value = self.values.get(name)
        if not isinstance(value, dict):
            self.fail(name, "an object")
        return Fields(value, self.where, f"{self.path}{name}.".lstrip("."))

    def objects(self, name: str) -> list["Fields"]:
        """Return a field with a list of objects."""
        items = self._items(name)
        return [items.object(item) for item in items.values]

    def integers(self, name: str) -> list[int]:
        """Return a field with a list of integers from 1."""
        items = self._items(name)
        return [items.integer(item) for item in items.values]

    def ranges(self, name: str) -> list[tuple[int, int]]:
        """Return a field with a list of ranges ``[first, last]`` of integers from 1."""
        items, found = self._items(name), list[tuple[int, int]]()
        for item in items.values:
            numbers = items.integers(item)
            if len(numbers) != len(("first", "last")) or numbers[1] < numbers[0]:
                items.fail(item, "[first, last]")
            found.append((numbers[0], numbers[1]))
        return found

    def _items(self, name: str) -> "Fields":
        value = self.values.get(name)
        if not isinstance(value, list):
            self.fail(name, "a list")
        return Fields({f"{name}[{i}]": each for i, each in enumerate(value)}, self.where, self.path)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a JSON number")

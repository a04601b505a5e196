"""Quantities written with their units: ``70ms``, ``3mm/s``, ``2N``.

Flow parameters annotated with one of the types below accept such text, as do options of commands.
"""

import re
from collections.abc import Mapping
from typing import Annotated, Final, NamedTuple, TypeAlias

from operators.errors import ParameterError

Duration: TypeAlias = Annotated[int, "ns"]
Length: TypeAlias = Annotated[float, "m"]
Speed: TypeAlias = Annotated[float, "m/s"]
Force: TypeAlias = Annotated[float, "N"]
Rate: TypeAlias = Annotated[float, "1/ns"]


class Kind(NamedTuple):
    """Kind of quantity, such as a length."""

    name: str
    units: Mapping[str, str]  # value of each in the base unit, as a fraction; smallest first
    examples: str


# by the base unit
KINDS: Final = {
    "ns": Kind(
        "a time",
        {"ns": "1", "us": "1000", "ms": "1000000", "s": "1000000000", "min": "60000000000"}
        | {"h": "3600000000000", "d": "86400000000000"},
        "500ms, 30s, 1h or 30d",
    ),
    "m": Kind("a length", {"mm": "1/1000", "cm": "1/100", "m": "1"}, "1.5mm or 0.0015m"),
    "m/s": Kind("a speed", {"mm/s": "1/1000", "cm/s": "1/100", "m/s": "1"}, "3mm/s or 0.003m/s"),
    "N": Kind("a force", {"N": "1"}, "2N or 0.5N"),
    "1/ns": Kind(
        "a rate", {"/h": "1/3600000000000", "/min": "1/60000000000", "/s": "1/1000000000"}, "1/min or 6/h"
    ),
    "1": Kind("a share", {"%": "1/100"}, "95%"),
}

_EXPONENT: Final = 1e15  # from which the format g writes one, which is not parsed
_LONGEST: Final = 40  # characters; longer text is not a number


def parse_quantity(owner: str, name: str, text: str, unit: str, *, signed: bool = False) -> float:
    """Parse a quantity and return it in its base unit; times are whole ns.

    >>> parse_quantity("record", "delay", "70 ms", "ns"), parse_quantity("collect", "--depth", "1.5mm", "m")
    (70000000, 0.0015)
    >>> parse_quantity("run", "--for", "5", "ns")
    Traceback (most recent call last):
    operators.errors.ParameterError: run: --for is '5', must be a time with its unit: 500ms, 30s, 1h or 30d

    `unit` is a key of `KINDS`. The error names `owner`, a command or flow, and its parameter `name`.

    Raises:
        ParameterError: if the text is not a quantity of this unit.
    """
    from fractions import Fraction

    kind = KINDS[unit]
    text = text.strip()
    match = re.fullmatch(r"([+-]?(?:\d+\.?\d*|\.\d+))\s*(\D+)", text, re.ASCII)
    short = len(text) <= _LONGEST
    if not short or match is None or match[2] not in kind.units or (match[1][0] == "-" and not signed):
        raise ParameterError(owner, name, text, f"{kind.name} with its unit: {kind.examples}")
    found = Fraction(match[1]) * Fraction(kind.units[match[2]])
    return round(found) if unit == "ns" else float(found)


def format_quantity(value: float, unit: str) -> str:
    """Return the shortest text that `parse_quantity` parses to this value.

    >>> format_quantity(70_000_000, "ns"), format_quantity(0.003, "m/s"), format_quantity(0.0, "N")
    ('70ms', '3mm/s', '0N')
    """
    from fractions import Fraction

    exact, found = Fraction(str(value)), list[str]()
    for name, factor in KINDS[unit].units.items():
        if abs(exact) >= Fraction(factor):
            number = float(exact / Fraction(factor))
            digits = ".15g" if abs(number) < _EXPONENT else ".0f"
            found.append(f"{number:{digits}}{name}")
    return min(reversed(found), key=len, default=f"{value:g}{unit}")

"""Quantities with units, as people write them: ``70ms``, ``3mm/s``, ``2N``.

A parameter of a flow that is annotated as one of the types below takes such text; so do options of commands.
"""

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Final, NamedTuple, TypeAlias

from operators.errors import ParameterError

Duration: TypeAlias = Annotated[int, "ns"]
Length: TypeAlias = Annotated[float, "m"]
Speed: TypeAlias = Annotated[float, "m/s"]
Force: TypeAlias = Annotated[float, "N"]


class Kind(NamedTuple):
    """A kind of quantity."""

    name: str
    units: Mapping[str, str]  # each in the base unit, as a fraction; smallest first
    examples: str


# by the base unit
KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "ns": Kind(
            "a time",
            {"ns": "1", "us": "1000", "ms": "1000000", "s": "1000000000", "min": "60000000000"}
            | {"h": "3600000000000"},
            "500ms, 30s, 5min or 1h",
        ),
        "m": Kind("a length", {"mm": "1/1000", "cm": "1/100", "m": "1"}, "1.5mm or 0.0015m"),
        "m/s": Kind("a speed", {"mm/s": "1/1000", "cm/s": "1/100", "m/s": "1"}, "3mm/s or 0.003m/s"),
        "N": Kind("a force", {"N": "1"}, "2N or 0.5N"),
    }
)

_LONGEST: Final = 40  # characters: a number has fewer


def quantity(owner: str, name: str, text: str, unit: str, *, signed: bool = False) -> float:
    """What a quantity is in its base unit, rounded once; whole ns for a time.

    >>> quantity("record", "delay", "70 ms", "ns"), quantity("collect", "--depth", "1.5mm", "m")
    (70000000, 0.0015)
    >>> quantity("run", "--for", "5", "ns")
    Traceback (most recent call last):
    operators.errors.ParameterError: run: --for is '5', must be a time with its unit: 500ms, 30s, 5min or 1h

    Args:
        owner: Whose it is, for the error.
        name: What it is called there.
        text: As it was written.
        unit: The base unit: one of `KINDS`.
        signed: Whether it may be below 0.

    Raises:
        ParameterError: if it is no such quantity.
    """
    from fractions import Fraction  # noqa: PLC0415 - `slipflow --help` must not wait for it

    kind = KINDS[unit]
    match = re.fullmatch(r"([+-]?(?:\d+\.?\d*|\.\d+))\s*(\D+)", text.strip()[:_LONGEST], re.ASCII)
    if match is None or match[2] not in kind.units or (match[1][0] == "-" and not signed):
        raise ParameterError(owner, name, text, f"{kind.name} with its unit: {kind.examples}")
    found = Fraction(match[1]) * Fraction(kind.units[match[2]])
    return round(found) if unit == "ns" else float(found)


def time(owner: str, name: str, text: str) -> int:
    """A time, in ns, as `quantity` reads it.

    >>> time("run", "--for", "1.5s")
    1500000000

    Raises:
        ParameterError: if it is none.
    """
    return int(quantity(owner, name, text, "ns"))


def written(value: float, unit: str) -> str:
    """A quantity as a person writes it, as short as may be; `quantity` reads it.

    >>> written(70_000_000, "ns"), written(100e9, "ns"), written(0.003, "m/s"), written(0.0, "N")
    ('70ms', '100s', '3mm/s', '0N')
    """
    from fractions import Fraction  # noqa: PLC0415 - `slipflow --help` must not wait for it

    exact, found = Fraction(str(value)), list[str]()
    for name, share in KINDS[unit].units.items():
        if abs(exact) >= Fraction(share):
            found.append(f"{float(exact / Fraction(share)):.15g}{name}")
    return min(reversed(found), key=len, default=f"{value:g}{unit}")

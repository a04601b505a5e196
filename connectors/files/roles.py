"""Roles of a table's columns: those that the map names, and those with common names."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final

from connectors.files.column_map import (
    COUNTS,
    LABEL,
    MOTIONS,
    SIZES,
    SPEED,
    TIME,
    UNITS,
    VELOCITY,
    ColumnMap,
)
from operators.errors import InputError

_MAP_IT: Final = "map it (import --map, ColumnMap.parse), for example"
_EXAMPLES: Final = {TIME: "time=t", COUNTS: "counts=p0..p5, or counts=left,right,top,bottom,tip,base"}
_NAMES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        TIME: ("t", "time", "timestamp", "stamp"),  # each also with a unit: t_ms, time [s]
        SPEED: ("speed", "v", "tcp_speed"),
        LABEL: ("label", "labels", "slip", "is_slip"),
    }
)
_CELL: Final = re.compile(
    r"(s|c|p|b|counts?|cells?|taxel|baro|barometer|pressure|sensor)([ _.]?)(\d{1,3})", re.IGNORECASE
)
_WITH_UNIT: Final = re.compile(r"(.+?)(?:[ _]?[\[(]([a-z/]+)[\])]|[ _]([a-z]+))", re.IGNORECASE)
_AXES: Final = (("vx", "vy", "vz", "wx", "wy", "wz"), ("vx", "vy", "vz"))


@dataclass(frozen=True)
class Header:
    """Column names of a table.

    Args:
        names: The names.
        where: Their place in messages.
        left_out: Reasons by names of what cannot be a column.
    """

    names: tuple[str, ...]
    where: str = "table"
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])

    def error(self, reason: str) -> InputError:
        """Return an error that lists the names."""
        listed = "; ".join(f"{name} cannot be used: {why}" for name, why in self.left_out.items())
        text = f"has the columns {' '.join(self.names)!r:.200}, {reason}"
        return InputError(self.where, f"{text} ({listed:.200})" if listed else text)

    def check(self, column: str) -> None:
        """Require that a column exists and can be used.

        Raises:
            InputError: if it does not, or cannot.
        """
        if column in self.left_out:
            raise InputError(self.where, f"column {column} cannot be used: {self.left_out[column]}")
        if column not in self.names:
            raise self.error(f"must have {column}")


def completed(columns: ColumnMap, header: Header) -> ColumnMap:
    """Return a map that is completed by columns with common names, without absent quantities.

    A time is required unless the map has a rate.

    Args:
        columns: Map as stated.
        header: Column names of a recording.

    Raises:
        InputError: if a column is missing, there are no counts or no time, or the choice is ambiguous.
    """
    found = dict(columns.columns)
    for name in SIZES:
        if name not in found:
            redundant = name in MOTIONS and any(found.get(other) for other in MOTIONS)
            found[name] = () if redundant else _guess(name, header)
    for name in (TIME, COUNTS) if columns.rate is None else (COUNTS,):
        if not found[name]:
            raise header.error(f"none recognised as {name}; {_MAP_IT} {_EXAMPLES[name]}")
    for column in (column for names in found.values() for column in names):
        header.check(column)
        if found[COUNTS].count(column) > 1:
            raise InputError(header.where, f"column {column} cannot be two cells")
    found = {name: found[name] for name in SIZES if found[name]}
    units = {name: columns.units.get(name) or _unit(name, found[name]) for name in found if name in UNITS}
    return replace(columns, columns=found, units=units)


def _guess(name: str, header: Header) -> tuple[str, ...]:
    """Return the columns with a common name of a quantity; none, if there are none."""
    candidates = list(_recognised(name, header.names))
    if len(candidates) > 1:
        several = " or ".join(repr(" ".join(each)) for each in candidates)
        example = f"{_MAP_IT} {name}={candidates[0][0]}"
        raise InputError(header.where, f"has several candidates for {name}: {several:.300}; {example}")
    return candidates[0] if candidates else ()


def _recognised(name: str, names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the columns with a common name of a quantity."""
    by_name = {each.casefold(): each for each in names}
    if name == COUNTS:
        yield from _cells(names)
    elif name == VELOCITY:
        for axes in _AXES:
            if set(axes) <= set(by_name):
                yield tuple(by_name[axis] for axis in axes)
                return
    else:
        usual = _NAMES.get(name, ())
        yield from ((each,) for each in names if _stem(name, each)[0].casefold() in usual)


def _cells(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield each group of columns that are numbered from 0 or from 1; groups of one only if alone."""
    rows: dict[tuple[str, str, str], dict[int, str]] = {}
    for name in names:
        stem, unit = _stem(COUNTS, name)
        if match := _CELL.fullmatch(stem):
            rows.setdefault((match[1], match[2], unit), {})[int(match[3])] = name
    groups = [tuple(row[number] for number in sorted(row)) for row in rows.values() if _is_numbered(row)]
    yield from [group for group in groups if len(group) > 1] or groups


def _is_numbered(numbers: Collection[int]) -> bool:
    first = min(numbers)
    return first <= 1 and sorted(numbers) == [*range(first, first + len(numbers))]


def _stem(quantity: str, column: str) -> tuple[str, str]:
    """Split the unit off a column name; an empty unit: it has none.

    >>> _stem("time", "t_ms"), _stem("counts", "cell 1 [kPa]"), _stem("time", "time_stamp")
    (('t', 'ms'), ('cell 1', 'kPa'), ('time_stamp', ''))
    """
    if match := _WITH_UNIT.fullmatch(column):
        known = {unit.casefold(): unit for unit in UNITS.get(quantity, ())}
        if unit := known.get((match[2] or match[3]).casefold()):
            return match[1], unit
    return column, ""


def _unit(name: str, columns: Sequence[str]) -> str:
    """Return the unit in the names of columns; without one, the first of the quantity."""
    units = {_stem(name, column)[1] for column in columns}
    found = units.pop() if len(units) == 1 else ""
    return found or next(iter(UNITS[name]))

"""Mapping of the columns of a CSV trace, given by the user or recognised by common names."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from operators.checks import check_choice
from operators.errors import InputError, ParameterError
from operators.fingertip import CELL_LIMIT

TIME, COUNTS, VELOCITY, SPEED, LABEL = "time", "counts", "velocity", "speed", "label"

_SPEEDS: Final = {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001}
UNITS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        TIME: {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0},  # ns
        VELOCITY: _SPEEDS,  # m/s; the last three are always rad/s
        SPEED: _SPEEDS,
    }
)
SIZES: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(
    {TIME: (1,), COUNTS: tuple(range(1, CELL_LIMIT + 1)), VELOCITY: (3, 6), SPEED: (1,), LABEL: (1,)}
)

_EXAMPLES: Final = {TIME: "time=t", COUNTS: "counts=p0..p5, or counts=left,right,top,bottom,tip,base"}
_NAMES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        TIME: ("t", "time", "timestamp", "stamp"),  # each also with _s, _ms, _us or _ns
        SPEED: ("speed", "v", "tcp_speed"),
        LABEL: ("label", "labels", "slip", "is_slip"),
    }
)
_CELL: Final = re.compile(
    r"(s|c|p|b|counts?|cell|taxel|baro|barometer|pressure|sensor)([ _.]?)(\d{1,3})", re.IGNORECASE
)
_AXES: Final = (("vx", "vy", "vz", "wx", "wy", "wz"), ("vx", "vy", "vz"))
_RANGE: Final = re.compile(r"(.*?)(\d+)\.\.(.*?)(\d+)")


@dataclass(frozen=True)
class ColumnMap:
    """Columns with the time, the counts, the arm's velocity or speed, and the labels.

    `completed` recognises unmapped quantities by their column names. An empty tuple: the quantity is absent.

    >>> ColumnMap.parse("time=stamp,counts=p0..p5,speed=v", "time=ms,speed=mm/s").columns["counts"]
    ('p0', 'p1', 'p2', 'p3', 'p4', 'p5')

    Args:
        columns: Column names by quantity: ``time``, ``counts`` (of cells 0, 1, ...), ``velocity`` (3 or 6,
            linear and angular, of the TCP in the base frame), ``speed`` or ``label``.
        units: Units of ``time`` (s, ms, us, ns), ``velocity`` and ``speed`` (m/s, cm/s, mm/s). The default is
            the ending of the time column's name, as in ``t_ms``, else s and m/s.

    Raises:
        ParameterError: on an unknown quantity or unit, or a wrong number of columns.
    """

    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    units: Mapping[str, str] = field(default_factory=dict[str, str])

    def __post_init__(self) -> None:
        for name, columns in self.columns.items():
            check_choice("column map", "quantity", name, SIZES)
            if len(columns) not in (0, *SIZES[name]):
                many = f"1 to {CELL_LIMIT}" if name == COUNTS else " or ".join(map(str, SIZES[name]))
                raise ParameterError("column map", name, ",".join(columns), f"{many} column names")
        if self.columns.get(VELOCITY) and self.columns.get(SPEED):
            raise ParameterError(
                "column map", SPEED, ",".join(self.columns[SPEED]), "omitted, since velocity is given"
            )
        for name, unit in self.units.items():
            check_choice("column map", "quantity with a unit", name, UNITS)
            check_choice("column map", f"unit of {name}", unit, UNITS[name])

    @classmethod
    def parse(cls, columns: str = "", units: str = "") -> "ColumnMap":
        """Parse texts such as ``time=t,counts=p0..p5,label=`` and ``time=ms``.

        Names are separated by commas. ``p0..p15`` is a range of 16 names; an empty list declares a quantity
        absent.

        Raises:
            ParameterError: as for the class, or if an item has no ``=``.
        """
        found = {
            name: tuple(column for item in items for column in _expanded(item))
            for name, items in _items("columns", columns)
        }
        return cls(found, {name: ",".join(items) for name, items in _items("units", units)})

    def completed(self, names: Sequence[str], where: str, *, timed: bool = True) -> "ColumnMap":
        """Return this map, completed by columns with common names.

        Args:
            names: Column names of a file.
            where: Name of the file's first line in messages.
            timed: Require a time column.

        Raises:
            InputError: if a column is missing or occurs twice, there are no counts or no time, or the choice
                is ambiguous.
        """
        found = dict(self.columns)
        for name in SIZES:
            if name not in found:
                redundant = found.get({VELOCITY: SPEED, SPEED: VELOCITY}.get(name, ""))
                candidates = [] if redundant else list(_recognised(name, names))
                if len(candidates) > 1:
                    several = " or ".join(repr(" ".join(each)) for each in candidates)
                    example = f"map it, for example {name}={candidates[0][0]}"
                    reason = f"has several candidates for {name}: {several}; {example}"
                    raise InputError(where, reason)
                found[name] = candidates[0] if candidates else ()
        for name in (TIME, COUNTS) if timed else (COUNTS,):
            if not found[name]:
                listed = f"has the columns {' '.join(names)!r:.200}"
                raise InputError(
                    where, f"{listed}, none recognised as {name}; map it, for example {_EXAMPLES[name]}"
                )
        for column in (column for columns in found.values() for column in columns):
            if column not in names:
                raise InputError(where, f"has the columns {' '.join(names)!r:.200}, must have {column}")
            if names.count(column) > 1 or f"{column}_duplicated_0" in names:  # polars renames the second
                raise InputError(where, f"has two columns {column}")
        units = {name: self.units.get(name, _unit(name, found[name])) for name in UNITS if found.get(name)}
        return ColumnMap({name: found[name] for name in SIZES if found[name]}, units)

    def scale(self, name: str) -> float:
        """Return the factor from the file's unit to ns or m/s."""
        return UNITS[name][self.units[name]]

    def __str__(self) -> str:
        return ",".join(f"{name}={','.join(columns)}" for name, columns in self.columns.items())


def _items(parameter: str, text: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each name before a ``=`` with the list after it."""
    found: dict[str, list[str]] = {}
    name = ""
    for item in text.split(",") if text.strip() else ():
        left, equals, right = item.partition("=")
        if equals:
            name = left.strip()
            found[name] = []
        elif not name:
            raise ParameterError("column map", parameter, text, "written as time=t,counts=p0..p5")
        value = (right if equals else left).strip()
        found[name] += [value] if value else []
    yield from found.items()


def _expanded(text: str) -> list[str]:
    """Expand a range such as ``p0..p5`` into column names.

    >>> _expanded("cell 6..cell 4")
    ['cell 6', 'cell 5', 'cell 4']
    """
    match = _RANGE.fullmatch(text)
    if match is None:
        return [text]
    prefix, first, again, last = match.groups()
    if again not in (prefix, ""):
        raise ParameterError("column map", "range of columns", text, "of one name, such as p0..p5")
    begin, end = int(first), int(last)
    if abs(end - begin) >= CELL_LIMIT:
        raise ParameterError("column map", "range of columns", text, f"of {CELL_LIMIT} columns at most")
    step = 1 if end >= begin else -1
    return [f"{prefix}{number}" for number in range(begin, end + step, step)]


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
        suffixes = ("", *(f"_{unit}" for unit in UNITS[TIME])) if name == TIME else ("",)
        usual = {f"{each}{suffix}" for each in _NAMES[name] for suffix in suffixes}
        yield from ((each,) for each in dict.fromkeys(names) if each.casefold() in usual)


def _cells(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield each group of at least two columns that are numbered from 0 or from 1."""
    rows: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if match := _CELL.fullmatch(name):
            rows.setdefault((match[1], match[2]), {})[int(match[3])] = name
    for row in rows.values():
        numbers = sorted(row)
        if len(row) > 1 and numbers[0] <= 1 and numbers == [*range(numbers[0], numbers[0] + len(row))]:
            yield tuple(row[number] for number in numbers)


def _unit(name: str, columns: tuple[str, ...]) -> str:
    if name != TIME:
        return "m/s"
    ending = columns[0].casefold().rpartition("_")[2]
    return ending if "_" in columns[0] and ending in UNITS[TIME] else "s"

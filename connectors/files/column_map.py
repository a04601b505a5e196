"""Interpretation of a table's columns, given by the user or recognised by common names."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final

from operators.batch import SLIP, STATIC, UNKNOWN
from operators.checks import check_above, check_choice
from operators.errors import InputError, ParameterError
from operators.fingertip import CELL_LIMIT

TIME, COUNTS, VELOCITY, SPEED, JOINT, LABEL = "time", "counts", "velocity", "speed", "joint", "label"
MOTIONS: Final = (VELOCITY, SPEED, JOINT)

_SPEEDS: Final = {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001}
_CELL_UNITS: Final = (  # units of one quantity can be converted
    {"count": 1.0},
    {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "psi": 6894.757293168},
    {"N": 1.0, "mN": 1e-3},
    {"V": 1.0, "mV": 1e-3},
    {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "G": 1e-4},
    {"ohm": 1.0, "kohm": 1e3},
    {"pF": 1.0},
)
_ALIASES: Final = {"counts": "count", "volt": "V", "volts": "V", "newton": "N", "gauss": "G"}
UNITS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        TIME: {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0},  # ns
        COUNTS: {unit: factor for units in _CELL_UNITS for unit, factor in units.items()},  # SI
        VELOCITY: _SPEEDS,  # m/s; the last three are always rad/s
        SPEED: _SPEEDS,
        JOINT: {"rad/s": 1.0, "deg/s": 0.017453292519943295},  # rad/s
    }
)
SIZES: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(
    {
        TIME: (1,),
        COUNTS: tuple(range(1, CELL_LIMIT + 1)),
        VELOCITY: (3, 6),
        SPEED: (1,),
        JOINT: (1,),
        LABEL: (1,),
    }
)
LABELS: Final[Mapping[str, int]] = MappingProxyType({"slip": SLIP, "static": STATIC, "unknown": UNKNOWN})

_DEFAULT_LABELS: Final = {"-1": UNKNOWN, "0": STATIC, "1": SLIP, "false": STATIC, "true": SLIP, **LABELS}
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
    r"(s|c|p|b|counts?|cell|taxel|baro|barometer|pressure|sensor)([ _.]?)(\d{1,3})", re.IGNORECASE
)
_WITH_UNIT: Final = re.compile(r"(.+?)(?:[ _]?[\[(]([a-z/]+)[\])]|[ _]([a-z]+))", re.IGNORECASE)
_AXES: Final = (
    ("vx", "vy", "vz", "wx", "wy", "wz"),
    ("vx", "vy", "vz"),
    *(  # geometry_msgs/TwistStamped and Twist
        tuple(f"{twist}{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")
        for twist in ("twist.", "")
    ),
)
_RANGE: Final = re.compile(r"(.*?)(\d+)\.\.(.*?)(\d+)")
_DIGITS: Final = re.compile(r"(\d+)")


@dataclass(frozen=True)
class Header:
    """Column names of a table.

    Args:
        names: The names; one may occur twice.
        where: Their place in messages.
        time: Column of the time if none is mapped.
        left_out: Reasons by names of what cannot be a column.
    """

    names: tuple[str, ...]
    where: str = "table"
    time: str | None = None
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])

    def error(self, reason: str) -> InputError:
        """Return an error that lists the names."""
        listed = "; ".join(f"{name} cannot be used: {why}" for name, why in self.left_out.items())
        text = f"has the columns {' '.join(self.names)!r:.200}, {reason}"
        return InputError(self.where, f"{text} ({listed:.200})" if listed else text)

    def check(self, column: str) -> None:
        """Require that a column occurs once.

        Raises:
            InputError: if it does not.
        """
        if column in self.left_out:
            raise InputError(self.where, f"column {column} cannot be used: {self.left_out[column]}")
        if column not in self.names:
            raise self.error(f"must have {column}")
        if self.names.count(column) > 1:
            raise InputError(self.where, f"has two columns {column}")

    def matching(self, column: str) -> list[str]:
        """Return the columns that match a pattern such as ``e*``, sorted by their numbers.

        Raises:
            InputError: if none matches.
        """
        if "*" not in column or column in self.names:
            return [column]
        pattern = re.compile(".*".join(map(re.escape, column.split("*"))), re.DOTALL)
        found = sorted(filter(pattern.fullmatch, dict.fromkeys(self.names)), key=natural)
        if not found:
            raise self.error(f"none of which matches {column}")
        return found


@dataclass(frozen=True)
class ColumnMap:
    """Columns with the time, the cells, the motion and the labels, and the meaning of their values.

    `completed` recognises unmapped quantities by their column names. An empty tuple: the quantity is absent.

    >>> ColumnMap.parse("time=stamp,counts=p0..p5,speed=v", "time=ms,speed=mm/s").columns["counts"]
    ('p0', 'p1', 'p2', 'p3', 'p4', 'p5')

    Args:
        columns: Column names by quantity: ``time``, ``counts`` (of cells 0, 1, ...), ``velocity`` (3 or 6,
            linear and angular, of the TCP in the base frame), ``speed``, ``joint`` (velocity of the joint
            that moves the fingertip) or ``label``. ``e*`` stands for all matching columns, by number.
        units: Units of ``time`` (s, ms, us, ns), ``counts`` (count, Pa, hPa, mbar, kPa, N, V and others),
            ``velocity`` and ``speed`` (m/s, cm/s, mm/s) and ``joint`` (rad/s, deg/s). ``Pa:kPa`` converts
            cells from Pa to kPa. The default is the ending of the column's name, as in ``t_ms``, else s,
            count, m/s and rad/s.
        labels: Values of the label column that mean ``slip``, ``static`` or ``unknown``. If only those for
            slip are given, all others are static. Default: 1, 0, -1, true, false and these three words.
        lever: Distance of the fingertip from the axis of the joint, m; its speed is the lever times the
            joint's absolute velocity.
        resolution: Units per stored count (default: 1 for counts; otherwise the largest of 1, 2, 2.5 or 5
            times a power of ten that keeps all digits of the values, or the smallest with which they fit).
        lenient: Values of cells and motion that are not numbers are missing, and rows without a time are left
            out; otherwise they are errors.

    Raises:
        ParameterError: on an unknown quantity or unit, a wrong number of columns or a missing lever.
    """

    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    lever: float | None = None
    resolution: float | None = None
    lenient: bool = False

    def __post_init__(self) -> None:
        for name, columns in self.columns.items():
            check_choice("column map", "quantity", name, SIZES)
            if not any("*" in column for column in columns):
                _check_size(name, columns)
        self._check_units()
        for name in self.labels:
            check_choice("column map", "label", name, LABELS)
        motions = [name for name in MOTIONS if self.columns.get(name)]
        if len(motions) > 1:
            given = ",".join(self.columns[motions[1]])
            raise ParameterError("column map", motions[1], given, f"omitted, since {motions[0]} is given")
        if self.lever is not None:
            check_above("column map", "lever", self.lever, 0, "m")
        elif JOINT in motions:
            must_be = "the distance from the joint's axis to the fingertip, m"
            raise ParameterError("column map", "lever", self.lever, must_be)
        if self.resolution is not None:
            check_above("column map", "resolution", self.resolution, 0)

    def _check_units(self) -> None:
        for name, unit in self.units.items():
            check_choice("column map", "quantity with a unit", name, UNITS)
            for each in unit.split(":", 1) if name == COUNTS else (unit,):
                check_choice("column map", f"unit of {name}", _ALIASES.get(each, each), UNITS[name])
        source, target = self.cell_units
        if source != target and not any({source, target} <= units.keys() for units in _CELL_UNITS):
            text = self.units[COUNTS]
            raise ParameterError("column map", "unit of counts", text, "two units of one quantity, as Pa:kPa")

    @classmethod
    def parse(
        cls,
        columns: str = "",
        units: str = "",
        labels: str = "",
        *,
        lever: float | None = None,
        resolution: float | None = None,
        lenient: bool = False,
    ) -> "ColumnMap":
        """Parse texts such as ``time=t,counts=p0..p5,label=``, ``time=ms`` and ``slip=1,2,static=0``.

        Names are separated by commas. ``p0..p15`` is a range of 16 names; an empty list declares a quantity
        absent.

        Raises:
            ParameterError: as for the class, or if an item has no ``=``.
        """
        found = {
            name: tuple(column for item in items for column in expanded(item))
            for name, items in _items("columns", columns, "time=t,counts=p0..p5")
        }
        values = {name: tuple(items) for name, items in _items("labels", labels, "slip=1,2,static=0")}
        unit_of = {name: ",".join(items) for name, items in _items("units", units, "time=ms,counts=kPa")}
        return cls(found, unit_of, values, lever, resolution, lenient)

    def completed(
        self, header: Header, *, timed: bool = True, only: Collection[str] = tuple(SIZES)
    ) -> "ColumnMap":
        """Return this map, completed by columns with common names.

        Args:
            header: Column names of a file.
            timed: Require a time column.
            only: Quantities in this file.

        Raises:
            InputError: if a column is missing or occurs twice, there are no counts or no time, or the choice
                is ambiguous.
        """
        found = dict[str, tuple[str, ...]]()
        for name in self.columns.keys() & only:
            columns = self.columns[name]
            found[name] = tuple(match for column in columns for match in header.matching(column))
            _check_size(name, found[name])
        if header.time and TIME not in found:
            found[TIME] = (header.time,)
        for name in SIZES:
            if name not in found and name in only:
                redundant = name in MOTIONS and any(found.get(other) for other in MOTIONS)
                found[name] = () if redundant else _guess(name, header)
        for name in (TIME, COUNTS) if timed else (COUNTS,):
            if name in only and not found[name]:
                raise header.error(f"none recognised as {name}; {_MAP_IT} {_EXAMPLES[name]}")
        for column in (column for columns in found.values() for column in columns):
            header.check(column)
            if found.get(COUNTS, ()).count(column) > 1:
                raise InputError(header.where, f"column {column} cannot be two cells")
        units = {name: self.units.get(name) or _unit(name, found[name]) for name in UNITS if found.get(name)}
        return replace(self, columns={name: found[name] for name in SIZES if found.get(name)}, units=units)

    def scale(self, name: str) -> float:
        """Return the factor from the file's unit to ns, m/s or rad/s, or to the unit of the counts."""
        if name != COUNTS:
            return UNITS[name][self.units[name]]
        source, target = self.cell_units
        return UNITS[COUNTS][source] / UNITS[COUNTS][target]

    @property
    def cell_units(self) -> tuple[str, str]:
        """Units of the cells in the file and after conversion."""
        source, _, target = self.units.get(COUNTS, "count").partition(":")
        return _ALIASES.get(source, source), _ALIASES.get(target or source, target or source)

    @property
    def label_codes(self) -> tuple[Mapping[str, int], int | None]:
        """Codes by value of the label column, and the code of other values (None: they are errors)."""
        if not self.labels:
            return _DEFAULT_LABELS, None
        codes = {_value(value): LABELS[name] for name, values in self.labels.items() for value in values}
        return codes, STATIC if set(self.labels) == {"slip"} else None

    def __str__(self) -> str:
        return ",".join(f"{name}={','.join(columns)}" for name, columns in self.columns.items())


def natural(name: str) -> tuple[tuple[int, str], ...]:
    """Return a key that sorts names by the numbers in them.

    >>> sorted(["e10", "e9", "e1"], key=natural)
    ['e1', 'e9', 'e10']
    """
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in _DIGITS.split(name))


def expanded(text: str) -> list[str]:
    """Expand a range such as ``p0..p5`` into column names.

    >>> expanded("cell 6..cell 4")
    ['cell 6', 'cell 5', 'cell 4']

    Raises:
        ParameterError: if it has two names or too many columns.
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


def _check_size(name: str, columns: Sequence[str]) -> None:
    if len(columns) not in (0, *SIZES[name]):
        many = f"1 to {CELL_LIMIT}" if name == COUNTS else " or ".join(map(str, SIZES[name]))
        raise ParameterError("column map", name, ",".join(columns), f"{many} column names")


def _value(text: str) -> str:
    """Return a value of a label column as `TraceTable.codes` compares it."""
    try:
        number = float(text)
    except ValueError:
        return text.strip().lower()
    return str(int(number)) if number.is_integer() else text.strip().lower()


def _items(parameter: str, text: str, example: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each name before a ``=`` with the list after it."""
    found: dict[str, list[str]] = {}
    name = ""
    for item in text.split(",") if text.strip() else ():
        left, equals, right = item.partition("=")
        if equals:
            name = left.strip()
            found[name] = []
        elif not name:
            raise ParameterError("column map", parameter, text, f"written as {example}")
        value = (right if equals else left).strip()
        found[name] += [value] if value else []
    yield from found.items()


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
        yield from ((each,) for each in dict.fromkeys(names) if _stem(name, each)[0].casefold() in usual)


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
    units = {_stem(name, column)[1] for column in columns}
    found = units.pop() if len(units) == 1 else ""
    return found or next(iter(UNITS[name]))

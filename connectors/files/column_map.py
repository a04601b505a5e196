"""Map of the columns of a recording: their meaning, units and formats."""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType
from typing import Any, Final, Self, TypeAlias

from operators.batch import SLIP, STATIC, UNKNOWN, s
from operators.checks import check_above, check_between, check_choice
from operators.errors import ParameterError
from operators.fingertip import CELL_LIMIT, grid

Layout: TypeAlias = tuple[tuple[int, ...], ...]

TIME, DATE, COUNTS, VELOCITY, SPEED, LABEL = "time", "date", "counts", "velocity", "speed", "label"
MOTIONS: Final = (VELOCITY, SPEED)
LABELS: Final[Mapping[str, int]] = MappingProxyType({"slip": SLIP, "static": STATIC, "unknown": UNKNOWN})
SIZES: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(  # allowed numbers of columns
    {TIME: (1,), DATE: (1,), COUNTS: (), VELOCITY: (3, 6), SPEED: (1,), LABEL: (1,)}
)
SEPARATORS: Final = {"comma": ",", "semicolon": ";", "tab": "\t", "pipe": "|", "space": " "}
_SPEEDS: Final = {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001}
_CELLS: Final = (
    *("count", "mPa", "Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi", "mmHg", "atm"),
    *("N", "mN", "g", "V", "mV", "uV", "A", "mA", "T", "mT", "uT", "G", "ohm", "kohm", "pF"),
)
UNITS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        TIME: {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "min": 6e10, "h": 3.6e12},  # ns
        COUNTS: dict.fromkeys(_CELLS, 1.0),  # stored as they are
        VELOCITY: _SPEEDS,  # m/s; the last three columns are always rad/s
        SPEED: _SPEEDS,
    }
)

_OWNER: Final = "column map"
_FINGERS: Final = 32767  # fingertip numbers have 16 bits
_EXAMPLE: Final = "time=t,counts=p0..p5,units.time=ms"
_RANGE: Final = re.compile(r"(.*?)(\d+)(\D*)\.\.(.*?)(\d+)(\D*)")  # of columns
_DIGITS: Final = 9  # of a column's number
_ROWS: Final = "5,4,3/0,1,2 (-1: no cell)"
_GRID: Final = re.compile(r"(\d{1,3}) *x *(\d{1,3})")  # rows x columns


@dataclass(frozen=True)
class ColumnMap:
    """Columns with the time, the cells, the motion and the labels, and the meaning of their values.

    What is not stated is concluded from the file. The map of a read `Trace` is complete.

    >>> found = ColumnMap.parse("time=stamp,counts=p0..p5,units.time=ms,layout=2x3")
    >>> found.cells, found.layout
    ({0: ('p0', 'p1', 'p2', 'p3', 'p4', 'p5')}, ((0, 1, 2), (3, 4, 5)))

    Args:
        columns: Column names by quantity: ``time``, ``date`` (if the time has none), ``counts`` (of cells 0,
            1, ...; a name may be a pattern such as ``taxel*``), ``counts.1`` of fingertip 1, ``velocity`` (3
            or 6, linear and angular, of the TCP in the base frame), ``speed`` or ``label``. An empty tuple:
            the quantity is absent.
        units: Units of ``time``, ``counts``, ``velocity`` and ``speed``. Any text is a unit of counts.
        labels: Values of the label column that mean ``slip``, ``static`` or ``unknown``. If only those for
            slip are given, all others are static.
        labelled: Label of all rows, of a file without a column of labels.
        resolution: Units per stored count.
        steps: Resolution of earlier files by unit, for files of one dataset whose resolution is not stated.
        offset: Counts that were subtracted from each cell, so that 16 bits suffice.
        layout: Rows of cell numbers, the top row first, as of a `Fingertip`.
        range: Readings at the lowest and at the highest pressure, in the unit of the cells.
        rate: Rows per second, Hz: of a file without times, which begin at 0; otherwise the expected rate.
        zeroed: Readings are relative to the unloaded fingertip.
        missing: Readings that mean that there is none, such as -999.
        separator: ``comma``, ``semicolon``, ``tab``, ``pipe`` or ``space``, of a CSV file.
        decimal: Sign of decimals, ``point`` or ``comma``.
        dates: Order in dates: ``ymd``, ``dmy`` or ``mdy``.

    Raises:
        ParameterError: on an unknown key or unit, a wrong number of columns or an invalid value.
    """

    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    labelled: str | None = None
    resolution: float | None = None
    offset: tuple[int, ...] | None = None
    layout: Layout | None = None
    range: tuple[float, float] | None = None
    rate: float | None = None
    zeroed: bool | None = None
    missing: tuple[float, ...] | None = None
    separator: str | None = None
    decimal: str | None = None
    dates: str | None = None
    steps: Mapping[str, float] = field(default_factory=dict[str, float], compare=False, repr=False)
    stated: tuple[str, ...] = field(default=(), compare=False, repr=False)  # other items of the parsed text

    def __post_init__(self) -> None:
        for name, columns in self.columns.items():
            quantity, dot, finger = name.partition(".")
            check_choice(_OWNER, "quantity", quantity, SIZES)
            if dot and (quantity != COUNTS or not finger.isdecimal()):
                raise ParameterError(_OWNER, "quantity", name, f"{quantity}, or counts.1 of fingertip 1")
            if len(columns) not in (0, *(SIZES[quantity] or range(1, CELL_LIMIT + 1))):
                many = " or ".join(map(str, SIZES[quantity])) or f"1 to {CELL_LIMIT}"
                raise ParameterError(_OWNER, name, ",".join(columns), f"{many} column names")
        if self.columns.get(COUNTS) and f"{COUNTS}.0" in self.columns:
            raise ParameterError(_OWNER, COUNTS, ",".join(self.columns[COUNTS]), "omitted beside counts.0")
        for name, unit in self.units.items():
            check_choice(_OWNER, "quantity with a unit", name, UNITS)
            if name != COUNTS or not unit or unit.casefold() in {each.casefold() for each in UNITS[COUNTS]}:
                check_choice(_OWNER, f"unit of {name}", unit, UNITS[name])
        for name in self.labels:
            check_choice(_OWNER, "label", name, LABELS)
        motions = [name for name in MOTIONS if self.columns.get(name)]
        if len(motions) > 1:
            given = ",".join(self.columns[motions[1]])
            raise ParameterError(_OWNER, motions[1], given, f"omitted, since {motions[0]} is given")
        self._check_values()

    def _check_values(self) -> None:
        if self.resolution is not None:
            check_above(_OWNER, "resolution", self.resolution, 0)
        if self.rate is not None:
            check_above(_OWNER, "rate", self.rate, 0)
            check_between(_OWNER, "rate", self.rate, 0, s, unit="Hz")
        for finger in self.cells:
            check_between(_OWNER, "finger", finger, 0, _FINGERS)
        for name, choices in _CHOICES.items():
            if (value := getattr(self, name)) is not None:
                check_choice(_OWNER, name, value, choices)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a text such as ``time=t,counts=p0..p5,label=,units.time=ms,labels.slip=1,2,layout=8x2``.

        A comma or a line break separates items. ``p0..p15`` is a range of 16 columns, ``taxel*`` all columns
        that begin so; an empty list declares a quantity absent.

        Raises:
            ParameterError: as for the class, or if the text has another form.
        """
        columns, units, labels = dict[str, tuple[str, ...]](), dict[str, str](), dict[str, tuple[str, ...]]()
        values, others = dict[str, Any](), list[str]()
        for item in re.split(r"[,\n](?=[^,\n=]*=)", text.strip()) if text.strip() else ():
            key, equals, value = map(str.strip, item.partition("="))
            if not equals:
                raise ParameterError("import", "--map", text, f"written as {_EXAMPLE}; for a file: @{item}")
            texts = tuple(each.strip() for each in value.split(",") if each.strip())
            table, _, name = key.partition(".")
            if key in SIZES or (table == COUNTS and name.isdecimal()):
                columns[key] = tuple(each for text in texts for each in expanded(text))
                continue
            value = ",".join(texts)
            others.append(f"{key}={value}")
            if name and table == "units":
                units[name] = value
            elif name and table == "labels":
                labels[name] = texts
            elif key in _PARSERS:
                values[key] = _parsed(key, value)
            else:
                check_choice(_OWNER, "key", key, (*SIZES, "counts.1", *_PARSERS, "units.time", "labels.slip"))
        return cls(columns, units, labels, **values, stated=tuple(others))

    @property
    def cells(self) -> dict[int, tuple[str, ...]]:
        """Columns of the cells by fingertip."""
        keys = (key for key, names in self.columns.items() if names and key.partition(".")[0] == COUNTS)
        return {int(key[7:] or 0): self.columns[key] for key in keys} or {0: ()}

    @property
    def cell_names(self) -> list[str]:
        """Columns of the cells of all fingertips."""
        return [name for names in self.cells.values() for name in names]

    @property
    def has_counts(self) -> bool:
        """Whether the readings are stored as they are, and so must be whole numbers."""
        return self.unit == "count" and self.resolution is None

    @property
    def decimal_sign(self) -> str:
        """Sign of decimals in texts."""
        return "," if self.decimal == "comma" else "."

    @property
    def unit(self) -> str:
        """Unit of the cells."""
        return self.units.get(COUNTS, "count")


def expanded(text: str) -> list[str]:
    """Expand a range such as ``p0..p5`` into column names.

    >>> expanded("cell 6..cell 4"), expanded("b0_P..b1_P")
    (['cell 6', 'cell 5', 'cell 4'], ['b0_P', 'b1_P'])

    Raises:
        ParameterError: if it has two names or too many columns.
    """
    match = _RANGE.fullmatch(text)
    if match is None:
        return [text]
    prefix, first, suffix, again, last, end = match.groups()
    if again not in (prefix, "") or end != suffix:
        raise ParameterError(_OWNER, "range of columns", text, "of one name, such as p0..p5")
    low, high = int(first[:_DIGITS]), int(last[:_DIGITS])
    if abs(high - low) >= CELL_LIMIT or max(len(first), len(last)) > _DIGITS:
        raise ParameterError(_OWNER, "range of columns", text, f"of {CELL_LIMIT} columns at most")
    step = 1 if high >= low else -1
    wide = len(first) if first[0] == "0" else 1
    return [f"{prefix}{number:0{wide}}{suffix}" for number in range(low, high + step, step)]


def shortened(names: Sequence[str]) -> str:
    """Return columns as a map states them: a range if they are one; ? replaces a comma, = or bracket."""
    names = [re.sub(r"[][,=]", "?", name) if re.search("[,=]", name) else name for name in names]
    with suppress(ParameterError):
        if names[2:] and expanded(text := f"{names[0]}..{names[-1]}") == [*names]:
            return text
    return ",".join(names)


def layout_text(layout: Layout) -> str:
    """Return a layout as a map states it.

    >>> layout_text(((5, 4, 3), (0, 1, 2)))
    '5,4,3/0,1,2'
    """
    return "/".join(",".join(map(str, row)) for row in layout)


def _layout(text: str) -> Layout:
    if match := _GRID.fullmatch(text.strip()):
        rows, columns = int(match[1]), int(match[2])
        if not 0 < rows * columns <= CELL_LIMIT:
            raise ValueError(text)
        return grid(rows * columns, columns)
    return tuple(tuple(int(cell) for cell in row.split(",")) for row in text.split("/"))


def _range(text: str) -> tuple[float, float]:
    low, high = map(float, text.split(":"))
    if not isfinite(low) or not isfinite(high):
        raise ValueError(text)
    return low, high


_CHOICES: Final[Mapping[str, Sequence[str]]] = {
    "labelled": tuple(LABELS),
    "separator": tuple(SEPARATORS),
    "decimal": ("point", "comma"),
    "dates": ("ymd", "dmy", "mdy"),
}
_PARSERS: Final[Mapping[str, tuple[Callable[[str], Any], str]]] = {  # parser and what the text must be
    "resolution": (float, "a number"),
    "layout": (_layout, f"ROWSxCOLUMNS such as 8x2 ({CELL_LIMIT} cells at most), or rows such as {_ROWS}"),
    "range": (_range, "LOW:HIGH, the readings at the lowest and at the highest pressure, such as 0:4000"),
    "rate": (float, "a number"),
    "zeroed": ({"true": True, "false": False}.__getitem__, "true or false"),
    "missing": (lambda text: tuple(map(float, text.split(",") if text else ())), "numbers such as -999"),
    **dict.fromkeys(_CHOICES, (str, "")),
}


def _parsed(key: str, text: str) -> Any:
    """Return the value of a key of `_PARSERS`."""
    parse, must_be = _PARSERS[key]
    try:
        return parse(text)
    except (ValueError, KeyError):
        raise ParameterError(_OWNER, key, text, must_be) from None

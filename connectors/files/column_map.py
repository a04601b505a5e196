"""Map of the columns of a recording: their meaning, units and layout; a text, a TOML file or Python."""

import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self, TypeAlias

from operators.batch import SLIP, STATIC, UNKNOWN, s
from operators.checks import check_above, check_between, check_choice
from operators.errors import InputError, ParameterError, os_error_reason
from operators.fingertip import CELL_LIMIT, grid

Layout: TypeAlias = tuple[tuple[int, ...], ...]

TIME, COUNTS, VELOCITY, SPEED, LABEL = "time", "counts", "velocity", "speed", "label"
MOTIONS: Final = (VELOCITY, SPEED)
LABELS: Final[Mapping[str, int]] = MappingProxyType({"slip": SLIP, "static": STATIC, "unknown": UNKNOWN})
SIZES: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(  # allowed numbers of columns
    {
        TIME: (1,),
        COUNTS: (*range(1, CELL_LIMIT + 1),),
        VELOCITY: (3, 6),
        SPEED: (1,),
        LABEL: (1,),
    }
)

_SPEEDS: Final = {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001}
_CELL_UNITS: Final = ("count", "Pa", "hPa", "mbar", "kPa", "MPa", "bar", "psi", "N", "mN", "V", "mV")
_OTHER_CELL_UNITS: Final = ("T", "mT", "uT", "G", "ohm", "kohm", "pF")
UNITS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        TIME: {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0},  # ns
        COUNTS: dict.fromkeys((*_CELL_UNITS, *_OTHER_CELL_UNITS), 1.0),  # stored as they are
        VELOCITY: _SPEEDS,  # m/s; the last three columns are always rad/s
        SPEED: _SPEEDS,
    }
)

_OWNER: Final = "column map"
_DEFAULT_LABELS: Final = {"-1": UNKNOWN, "0": STATIC, "1": SLIP, "false": STATIC, "true": SLIP, **LABELS}
_FINGERS: Final = 32767  # fingertip numbers have 16 bits
_EXAMPLE: Final = "time=t,counts=p0..p5,units.time=ms, or a file such as pad.toml"
_RANGE: Final = re.compile(r"(.*?)(\d+)\.\.(.*?)(\d+)")  # of columns
_GRID: Final = re.compile(r"(\d{1,3}) *x *(\d{1,3})")  # rows x columns


@dataclass(frozen=True)
class ColumnMap:
    """Columns with the time, the cells, the motion and the labels, and the meaning of their values.

    Quantities that are not mapped are recognised by column names. An empty tuple: the quantity is absent.

    >>> found = ColumnMap.parse("time=stamp,counts=p0..p5,units.time=ms,layout=2x3")
    >>> found.columns["counts"], found.layout
    (('p0', 'p1', 'p2', 'p3', 'p4', 'p5'), ((0, 1, 2), (3, 4, 5)))

    Args:
        columns: Column names by quantity: ``time``, ``counts`` (of cells 0, 1, ...), ``velocity`` (3 or 6,
            linear and angular, of the TCP in the base frame), ``speed`` or ``label``.
        units: Units of ``time``, ``counts``, ``velocity`` and ``speed``, as in `UNITS`. The default is the
            ending of the column's name, as in ``t_ms``, else s, count and m/s.
        labels: Values of the label column that mean ``slip``, ``static`` or ``unknown``. If only those for
            slip are given, all others are static. Default: 1, 0, -1, true, false and these three words.
        resolution: Units per stored count (default: 1 for counts; otherwise the largest of 1, 2, 2.5 or 5
            times a power of ten that keeps all digits of the values, or the smallest with which they fit).
        layout: Rows of cell numbers, the top row first, as of a `Fingertip`; None: unknown.
        range: Readings at the lowest and at the highest pressure, in the unit of the cells; None: unknown.
        rate: Rows per second, Hz: of a file without times, which begin at 0; otherwise the expected rate.
        zeroed: Readings are relative to the unloaded fingertip; None: if one is negative.
        finger: Number of the fingertip.

    Raises:
        ParameterError: on an unknown quantity or unit, a wrong number of columns or an invalid value.
    """

    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    resolution: float | None = None
    layout: Layout | None = None
    range: tuple[float, float] | None = None
    rate: float | None = None
    zeroed: bool | None = None
    finger: int = 0

    def __post_init__(self) -> None:
        for name, columns in self.columns.items():
            check_choice(_OWNER, "quantity", name, SIZES)
            _check_size(name, columns)
        for name, unit in self.units.items():
            check_choice(_OWNER, "quantity with a unit", name, UNITS)
            check_choice(_OWNER, f"unit of {name}", unit, UNITS[name])
        for name in self.labels:
            check_choice(_OWNER, "label", name, LABELS)
        motions = [name for name in MOTIONS if self.columns.get(name)]
        if len(motions) > 1:
            given = ",".join(self.columns[motions[1]])
            raise ParameterError(_OWNER, motions[1], given, f"omitted, since {motions[0]} is given")
        for name in ("resolution", "rate"):
            if (value := getattr(self, name)) is not None:
                check_above(_OWNER, name, value, 0)
        if self.rate is not None:
            check_between(_OWNER, "rate", self.rate, 0, s, unit="Hz")
        check_between(_OWNER, "finger", self.finger, 0, _FINGERS)

    @classmethod
    def load(cls, text: str) -> Self:
        """Return the map of a TOML file, if `text` names one, or of a text as of `parse`.

        Raises:
            InputError: if the file cannot be read or is not TOML.
            ParameterError: if the map is invalid.
        """
        path = Path(text)
        if path.suffix != ".toml":
            return cls.parse(text)
        try:
            table = tomllib.loads(path.read_text("utf-8"))
        except OSError as error:
            raise InputError(text, f"cannot be read: {os_error_reason(error)}") from None
        except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, a number without end
            raise InputError(text, f"is not valid TOML: {error}") from None
        try:
            return cls._of(dict(_flat("", table)))
        except ParameterError as error:
            raise ParameterError(text, error.name, error.value, error.must_be) from None

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a text such as ``time=t,counts=p0..p5,label=,units.time=ms,labels.slip=1,2,layout=8x2``.

        ``p0..p15`` is a range of 16 columns; an empty list declares a quantity absent. The keys are those of
        the TOML file.

        Raises:
            ParameterError: as for the class, or if the text has another form.
        """
        found: dict[str, list[str]] = {}
        name = ""
        for item in text.split(",") if text.strip() else ():
            left, equals, right = item.partition("=")
            if equals:
                name = left.strip()
                found[name] = []
            elif not name:
                raise ParameterError("import", "--map", text, f"written as {_EXAMPLE}")
            value = (right if equals else left).strip()
            found[name] += [value] if value else []
        return cls._of(found)

    @classmethod
    def _of(cls, items: Mapping[str, Sequence[str]]) -> Self:
        """Return the map of the values of each key; a key is dotted, as in ``units.time``."""
        columns, units, labels = dict[str, tuple[str, ...]](), dict[str, str](), dict[str, tuple[str, ...]]()
        values = dict[str, Any]()
        for key, texts in items.items():
            table, _, name = key.partition(".")
            if name and table == "units":
                units[name] = ",".join(texts)
            elif name and table == "labels":
                labels[name] = tuple(texts)
            elif key in SIZES:
                columns[key] = tuple(each for text in texts for each in expanded(text))
            elif key in _PARSERS:
                values[key] = _parsed(key, ",".join(texts))
            else:
                known = (*SIZES, *_PARSERS, "units.time", "labels.slip")
                check_choice(_OWNER, "key", key, known)
        return cls(columns, units, labels, **values)

    def scale(self, name: str) -> float:
        """Return the factor from the file's unit to ns or m/s."""
        return UNITS[name][self.units[name]]

    @property
    def unit(self) -> str:
        """Unit of the cells."""
        return self.units.get(COUNTS, "count")

    @property
    def label_codes(self) -> tuple[Mapping[str, int], int | None]:
        """Codes by value of the label column, and the code of other values (None: they are errors)."""
        if not self.labels:
            return _DEFAULT_LABELS, None
        codes = {_value(value): LABELS[name] for name, values in self.labels.items() for value in values}
        return codes, STATIC if set(self.labels) == {"slip"} else None


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
        raise ParameterError(_OWNER, "range of columns", text, "of one name, such as p0..p5")
    begin, end = int(first), int(last)
    if abs(end - begin) >= CELL_LIMIT:
        raise ParameterError(_OWNER, "range of columns", text, f"of {CELL_LIMIT} columns at most")
    step = 1 if end >= begin else -1
    return [f"{prefix}{number}" for number in range(begin, end + step, step)]


def _check_size(name: str, columns: Sequence[str]) -> None:
    """Require that a quantity has an allowed number of columns, or none.

    Raises:
        ParameterError: on another number.
    """
    if len(columns) not in (0, *SIZES[name]):
        many = f"1 to {CELL_LIMIT}" if name == COUNTS else " or ".join(map(str, SIZES[name]))
        raise ParameterError(_OWNER, name, ",".join(columns), f"{many} column names")


def layout_text(layout: Layout) -> str:
    """Return a layout as a map states it.

    >>> layout_text(((5, 4, 3), (0, 1, 2)))
    '5,4,3/0,1,2'
    """
    return "/".join(",".join(map(str, row)) for row in layout)


def _flat(name: str, value: object) -> Iterator[tuple[str, list[str]]]:
    """Yield the dotted keys of a TOML table, with their values as texts."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _flat(f"{name}.{key}" if name else key, each)
    elif isinstance(value, list):
        yield name, [_text(each) for each in value]
    else:
        yield name, [each.strip() for each in _text(value).split(",") if each.strip()]


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _value(text: str) -> str:
    """Return a value of a label column as `TraceTable.codes` compares it."""
    try:
        number = float(text)
    except ValueError:
        return text.strip().lower()
    return str(int(number)) if number.is_integer() else text.strip().lower()


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


_PARSERS: Final[Mapping[str, tuple[Callable[[str], Any], str]]] = {  # parser and what the text must be
    "resolution": (float, "a number"),
    "layout": (
        _layout,
        f"ROWSxCOLUMNS such as 8x2 ({CELL_LIMIT} cells at most), or rows such as 5,4,3/0,1,2 (-1: no cell)",
    ),
    "range": (_range, "LOW:HIGH, the readings at the lowest and at the highest pressure, such as 0:4000"),
    "rate": (float, "a number"),
    "zeroed": ({"true": True, "false": False}.__getitem__, "true or false"),
    "finger": (int, "a whole number"),
}


def _parsed(key: str, text: str) -> Any:  # noqa: ANN401 - of the type of the key
    """Return the value of a key of `_PARSERS`."""
    parse, must_be = _PARSERS[key]
    try:
        return parse(text)
    except (ValueError, KeyError):
        raise ParameterError(_OWNER, key, text, must_be) from None

"""Table as a recording's file has it: columns of texts or typed values, and what was found in them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from shlex import quote
from typing import Final, Self

import numpy as np
import polars as pl
from numpy.typing import NDArray

from operators.batch import Flags
from operators.errors import InputError

VALUES: Final = 1 << 26  # of a file; an import takes about 48 bytes of memory for each
COLUMN_LIMIT: Final = 4096

_SHOWN: Final = 8  # problems in an error
_NAMES_SHOWN: Final = 20
_USABLE: Final = (pl.String, pl.Boolean, pl.Categorical, pl.Enum, pl.Null)  # and numbers, dates and times


@dataclass
class RawTable:
    """Columns of a recording, and what was found in them. A missing value is null, NaN or an empty text."""

    columns: Mapping[str, pl.Series]  # (n,) each
    file: str  # name, also of a table in memory
    place: str  # word for a row in messages
    numbers: NDArray[np.int64]  # (n,) of the rows in messages
    units: Mapping[str, str] = field(default_factory=dict[str, str])  # by column, of a row below the names
    separator: str | None = None  # name, of a CSV file
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])  # reasons by names
    sha256: str = ""  # of the file, hex
    notes: list[str] = field(default_factory=list[str])  # conclusions on how the file is read
    warnings: list[tuple[int | None, str]] = field(default_factory=list[tuple[int | None, str]])
    problems: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])  # place, reason
    fixes: list[str] = field(default_factory=list[str])  # items of a map that solve problems
    suggested: list[str] = field(default_factory=list[str])  # items of a map that has the table's columns

    @classmethod
    def of(
        cls, frame: pl.DataFrame, file: str, left_out: Mapping[str, str] | None = None, sha256: str = ""
    ) -> Self:
        """Return the table of typed columns.

        Lists of equal length become columns ``name0``, ``name1``, ..., structs ``name.field``.

        Raises:
            InputError: if two columns get the same name.
        """
        columns, reasons = dict[str, pl.Series](), dict(left_out or {})
        for column in frame:
            for name, values in _flat(column.name, column):
                if name in columns:
                    raise InputError(file, f"column {name} is also part of column {column.name}: rename one")
                if reason := _unusable(values):
                    reasons[name] = reason
                else:
                    columns[name] = _plain(values)
        return cls(columns, file, "row", np.arange(frame.height), left_out=reasons, sha256=sha256)

    def __len__(self) -> int:
        return len(self.numbers)

    def place_of(self, row: int, column: str) -> str:
        """Return the place of a value in messages."""
        return f"{self.place} {self.numbers[row]}, column {column}"

    def warn(self, text: str, row: int | None = None) -> None:
        """Add a doubt about implausible values, of the part with a row or of all parts."""
        self.warnings.append((row, text))

    def add_problem(self, reason: str, place: str = "", *, about: str = "", fix: str | None = None) -> None:
        """Add a problem at a place; of each subject, by default the place, only the first."""
        subject = about or place or reason
        if subject not in self.problems:
            self.problems[subject] = place, reason
            self.fixes += [] if fix is None else [fix]

    def check(self, name: str, good: Flags, must_be: str) -> None:
        """Add the first invalid value of a column as a problem, once for all columns; `good`: (n,)."""
        if not good.all():
            row = int(np.argmin(good))
            found = self.columns[name][row]
            text = "''" if found is None else repr(found) if isinstance(found, str) else f"{found}"
            self.add_problem(f"is {text:.40}, must be {must_be}", self.place_of(row, name), about=must_be)

    def stop(self) -> None:
        """Raise an error, if there are problems.

        Raises:
            InputError: that lists all problems, and a map that solves them.
        """
        items = {item.partition("=")[0]: item for item in (*self.suggested, *self.fixes) if item}
        remedy = f"; try --map {quote(','.join(items.values()))}" if self.fixes else ""
        if len(self.problems) == 1:
            [(place, reason)] = self.problems.values()
            raise InputError(f"{self.file}, {place}" if place else self.file, f"{reason}{remedy}")
        if self.problems:
            listed = [f"{place} {reason}".strip() for place, reason in self.problems.values()][:_SHOWN]
            text = "; ".join(f"({number}) {each}" for number, each in enumerate(listed, 1))
            text += "; ..." if len(self.problems) > _SHOWN else ""
            raise InputError(self.file, f"has {len(self.problems)} problems: {text}{remedy}")


def listed(names: Sequence[str]) -> str:
    """Return names as text, without those beyond the first `_NAMES_SHOWN`."""
    more = f" and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    return " ".join(names[:_NAMES_SHOWN]) + more


def check_size(where: str, values: int, columns: int = 0) -> None:
    """Require that a table has no more values and columns than `VALUES` and `COLUMN_LIMIT`.

    Raises:
        InputError: if it has more.
    """
    if columns > COLUMN_LIMIT:
        raise InputError(where, f"has more than {COLUMN_LIMIT} columns: is it a table with a row per time?")
    if values > VALUES:
        reason = f"has more than {VALUES >> 20} million values, the limit: split it into several files"
        raise InputError(where, reason)


def _flat(name: str, column: pl.Series) -> Iterator[tuple[str, pl.Series]]:
    """Yield the scalar columns of a column, and what cannot be split into them."""
    if isinstance(column.dtype, pl.Struct):
        for each in column.struct.fields:
            yield from _flat(f"{name}.{each}", column.struct.field(each))
        return
    if isinstance(column.dtype, pl.Array) and column.dtype.inner != pl.Object:
        column = column.arr.to_list()
    sizes = column.list.len().unique().drop_nulls() if isinstance(column.dtype, pl.List) else pl.Series([])
    if len(sizes) == 1 and sizes.item() <= COLUMN_LIMIT and sizes.item() * len(column) <= VALUES:
        for item in range(sizes.item()):
            yield from _flat(f"{name}{item}", column.list.get(item))
    else:
        yield name, column


def _unusable(column: pl.Series) -> str:
    """Return why a column cannot be used; empty: it can."""
    kind = column.dtype
    if isinstance(kind, pl.List):
        return "its lists differ in length, or are too long"
    good = kind.is_numeric() or kind.is_temporal() or isinstance(kind, _USABLE)
    return "" if good else f"its values are {kind}, not numbers, texts or dates"


def _plain(column: pl.Series) -> pl.Series:
    """Return categories as texts, durations as times since 1970, and a column without values as numbers."""
    if isinstance(column.dtype, pl.Duration):
        return column.cast(pl.Duration("ns")).to_physical().cast(pl.Datetime("ns"))
    if isinstance(column.dtype, pl.Categorical | pl.Enum):
        return column.cast(pl.String)
    return column.cast(pl.Float64) if isinstance(column.dtype, pl.Null) else column

"""Table of a recording: columns of a polars DataFrame, converted on request; errors name row and column."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from connectors.files.column_map import TIME, UNITS
from connectors.files.roles import Header
from operators.batch import Codes, Flags, Reals, Times
from operators.errors import InputError

LIMIT: Final = 1 << 29  # bytes of a file, packed or unpacked
VALUES: Final = 1 << 26  # of a file; an import takes about 48 bytes of memory for each

_DIGITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}  # decimal places of a time, down to 1 ns
_TIME_LIMIT: Final = float(1 << 63)  # ns
_DATE: Final = r"^\d{4}-\d{2}-\d{2}[T ]"


class TraceTable:
    """Columns of a recording. A missing value is null, NaN or an empty text.

    Args:
        frame: The columns; lists of equal length become columns ``name0``, ``name1``, ..., structs
            ``name.field``.
        file: Name of the file, or of the table in memory.
        named_by: Place of the names in messages, such as ``line 1``.
        place: Word for a row in messages.
        numbers: Numbers of the rows (n,) in messages (default: from 0).
        sha256: Checksum of the file, hex.
        notes: Remarks on how the file was read, for the preview.
        left_out: Reasons by names of what cannot be a column.

    Attributes:
        header: Names of the columns.

    Raises:
        InputError: if there are no rows or no usable columns.
    """

    def __init__(
        self,
        frame: pl.DataFrame,
        file: str = "table",
        *,
        named_by: str = "",
        place: str = "row",
        numbers: NDArray[np.int64] | None = None,
        sha256: str = "",
        notes: Sequence[str] = (),
        left_out: Mapping[str, str] | None = None,
    ) -> None:
        self.file, self.sha256, self.notes = file, sha256, tuple(notes)
        self._columns, reasons = dict[str, pl.Series](), dict(left_out or {})
        for column in frame:
            for name, values in _flat(column.name, column):
                if reason := _unusable(values):
                    reasons[name] = reason
                else:
                    self._columns.setdefault(name, _plain(values))
        if frame.height == 0:
            raise InputError(file, "has no rows" + (f" below {named_by}" if named_by else ""))
        if not self._columns:
            raise InputError(file, "has no columns of numbers or texts")
        where = f"{file}, {named_by}" if named_by else file
        self.header = Header(tuple(self._columns), where, reasons)
        self._place = place
        self._numbers = np.arange(frame.height) if numbers is None else numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def times(self, name: str, unit: str) -> Times:
        """Return a column of times (n,) in ns; `unit` is the unit in the file: s, ms, us or ns.

        Decimal text is converted exactly, then rounded to the nearest ns. Dates are ns since 1970 UTC.

        Raises:
            InputError: on a value that is not a time, or is less than the previous one.
        """
        must_be = "a whole number of ns" if unit == "ns" else f"a time in {unit}"
        numbers = _nanoseconds(self._columns[name], unit)
        self.check(name, numbers.is_not_null().to_numpy(), must_be)
        times: Times = numbers.to_numpy()
        order = f"no less than in the {self._place} before"
        self.check(name, np.diff(times, prepend=times[0]) >= 0, order)
        return times

    def reals(self, name: str) -> Reals:
        """Return a column of numbers (n,); NaN for a missing value.

        Raises:
            InputError: on a value that is not a finite number.
        """
        column = self._columns[name]
        values: Reals = column.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy().copy()
        given = column.is_not_null().to_numpy()
        if column.dtype == pl.String:
            given &= ~column.str.to_lowercase().is_in(["", "nan"]).fill_null(value=True).to_numpy()
        else:
            given &= ~np.isnan(values)
        self.check(name, np.isfinite(values) | ~given, "a number or empty")
        return values

    def codes(self, name: str, values: Mapping[str, int], other: int | None, missing: int) -> Codes:
        """Return a column of codes (n,), translated from texts, truth values or whole numbers.

        Args:
            name: Name of the column.
            values: Code of each value; letters in lower case, whole numbers without a decimal point.
            other: Code of all other values; None: they are errors.
            missing: Code of missing values.

        Raises:
            InputError: on another value.
        """
        column = self._columns[name]
        numbers = column.cast(pl.Float64, strict=False)
        whole = (numbers == numbers.round()) & (numbers.abs() < 2.0**53)
        text = column.cast(pl.String, strict=False).str.strip_chars().str.to_lowercase()
        if column.dtype != pl.Boolean:
            text = text.zip_with(
                ~whole.fill_null(value=False), numbers.cast(pl.Int64, strict=False).cast(pl.String)
            )
        absent = text.is_null() | text.is_in(["", "nan"])
        codes = text.replace_strict(dict(values), default=other, return_dtype=pl.Int8)
        codes = codes.zip_with(~absent, pl.Series([missing], dtype=pl.Int8).new_from_index(0, len(codes)))
        self.check(name, codes.is_not_null().to_numpy(), f"one of {', '.join(values)}")
        return codes.to_numpy()

    def check(self, name: str, good: Flags, must_be: str) -> None:
        """Require that every value of a column is valid.

        Args:
            name: Name of the column.
            good: (n,) False for a value that is not.
            must_be: Requirement, for the message.

        Raises:
            InputError: naming the first value that is not.
        """
        if not good.all():
            row = int(np.argmin(good))
            found = self._columns[name][row]
            text = "''" if found is None else repr(found) if isinstance(found, str) else f"{found}"
            where = f"{self.file}, {self._place} {self._numbers[row]}, column {name}"
            raise InputError(where, f"is {text:.40}, must be {must_be}")


def check_size(where: str, values: int) -> None:
    """Check the number of values of a table.

    Raises:
        InputError: if it exceeds `VALUES`.
    """
    if values > VALUES:
        reason = f"has more than {VALUES >> 20} million values, the limit: split it into several files"
        raise InputError(where, reason)


def _flat(name: str, column: pl.Series) -> Iterator[tuple[str, pl.Series]]:
    """Yield the scalar columns of a column, and what cannot be split into them."""
    if isinstance(column.dtype, pl.Struct):
        for each in column.struct.fields:
            yield from _flat(f"{name}.{each}", column.struct.field(each))
        return
    if isinstance(column.dtype, pl.Array):
        column = column.arr.to_list()
    sizes = column.list.len().unique().drop_nulls() if isinstance(column.dtype, pl.List) else pl.Series([])
    if len(sizes) == 1 and sizes.item() * len(column) <= VALUES:
        for item in range(sizes.item()):
            yield from _flat(f"{name}{item}", column.list.get(item))
    else:
        yield name, column


def _unusable(column: pl.Series) -> str:
    """Return why a column cannot be used; empty: it can."""
    if isinstance(column.dtype, pl.List):
        return "its lists differ in length"
    if isinstance(column.dtype, pl.Object | pl.Binary):
        return f"its values are {column.dtype}, not numbers, texts or dates"
    return ""


def _plain(column: pl.Series) -> pl.Series:
    """Return a column of categories as texts, and one without values as numbers."""
    if isinstance(column.dtype, pl.Categorical | pl.Enum):
        return column.cast(pl.String)
    return column.cast(pl.Float64) if isinstance(column.dtype, pl.Null) else column


def _nanoseconds(column: pl.Series, unit: str) -> pl.Series:
    """Return times as whole ns; null for other values."""
    if column.dtype == pl.String and column.filter(column != "").head(1).str.contains(_DATE).any():
        column = _dates(column)
    kind = column.dtype
    if kind == pl.Duration:
        return column.cast(pl.Duration("ns"), strict=False).to_physical()
    if kind.is_temporal():
        return column.cast(pl.Datetime("ns"), strict=False).to_physical()
    if kind.is_float():
        return _rounded(column, unit)
    if unit == "ns":
        return column.cast(pl.Int64, strict=False)
    decimals = column.cast(pl.Decimal(38, _DIGITS[unit]), strict=False)
    return decimals.to_physical().cast(pl.Int64, strict=False)


def _dates(column: pl.Series) -> pl.Series:
    """Return ISO dates, with a decimal point or comma, as times; null for other values."""
    texts = column.str.replace(",", ".", literal=True)
    try:
        return texts.str.to_datetime(time_unit="ns", strict=False)
    except pl.exceptions.PolarsError:  # no value shows the format
        return pl.Series([None] * len(column), dtype=pl.Datetime("ns"))


def _rounded(column: pl.Series, unit: str) -> pl.Series:
    """Return times of floating point as whole ns; null for other values."""
    with np.errstate(over="ignore"):
        values = column.cast(pl.Float64).fill_null(np.nan).to_numpy() * UNITS[TIME][unit]
    if unit == "ns":
        values = np.where(values == np.rint(values), values, np.nan)
    good = np.abs(values) < _TIME_LIMIT
    whole = pl.Series(np.rint(np.where(good, values, 0)).astype(np.int64))
    return whole.zip_with(pl.Series(good), pl.Series([None], dtype=pl.Int64).new_from_index(0, len(whole)))

"""Table of named columns, read from a file of any format or given as arrays; errors name row and column."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from connectors.files.column_map import TIME, UNITS, Header
from operators.batch import Codes, Flags, Reals, Times
from operators.errors import InputError

LIMIT: Final = 1 << 29  # bytes of a file, and of its unpacked columns; an import takes six times as many
VALUE_SIZE: Final = 8  # bytes of an unpacked value

Values: TypeAlias = "NDArray[Any] | Sequence[object] | pl.Series"

_DIGITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}  # decimal places of a time, down to 1 ns
_TIME_LIMIT: Final = float(1 << 63)  # ns
_DATE: Final = r"^\d{4}-\d{2}-\d{2}[T ]"


class TraceTable:
    """Columns of a file, converted on request.

    A missing value is null, NaN or an empty text.

    Args:
        columns: Values by column name: arrays (n,), lists or polars Series.
        file: Name of the file.
        where: Name of the table in messages (default: `file`).
        names: Names of the columns, if some occur twice.
        named_by: Place of the names in messages, such as ``line 1``.
        place: Word for a row in messages.
        numbers: Numbers of the rows (n,) in messages (default: from 0).
        sha256: Checksum of the file, hex.
        time: Column with the time if none is mapped.
        notes: Remarks on how the file was read, for the preview.
        left_out: Reasons by names of what cannot be a column.

    Attributes:
        header: Names of the columns.
        about: Further entries of the description, such as the topic.
        motion: Table with the motion at other times; None: it is in this table.

    Raises:
        InputError: if there are no rows, or a column has another length or no scalars.
    """

    def __init__(
        self,
        columns: Mapping[str, Values],
        file: str = "table",
        *,
        where: str = "",
        names: Sequence[str] = (),
        named_by: str = "",
        place: str = "row",
        numbers: NDArray[np.int64] | None = None,
        sha256: str = "",
        time: str | None = None,
        notes: Sequence[str] = (),
        left_out: Mapping[str, str] | None = None,
    ) -> None:
        self.file, self.where, self.sha256, self.notes = file, where or file, sha256, tuple(notes)
        place_of_names = f"{self.where}, {named_by}" if named_by else self.where
        self.about = dict[str, str]()
        self.motion: TraceTable | None = None
        self.header = Header(tuple(names or columns), place_of_names, time, left_out or {})
        self._columns = {name: _series(self.where, name, values) for name, values in columns.items()}
        lengths = {name: len(values) for name, values in self._columns.items()}
        self._length = next(iter(lengths.values()), 0)
        for name, length in lengths.items():
            if length != self._length:
                first = next(iter(lengths))
                raise InputError(
                    self.where, f"column {name} has {length} rows, column {first} {self._length}"
                )
        if not self._length:
            raise InputError(self.where, "has no rows" + (f" below {named_by}" if named_by else ""))
        self._place, self._numbers = place, numbers

    def __len__(self) -> int:
        return self._length

    def selected(self, rows: Flags) -> "TraceTable":
        """Return a table of some rows; messages keep the numbers of the rows.

        Args:
            rows: (n,) True for a row to keep.

        Raises:
            InputError: if there is none.
        """
        if not rows.any():
            raise InputError(self.where, "has no valid row")
        header, numbers = self.header, np.arange(len(self)) if self._numbers is None else self._numbers
        found = TraceTable(
            {name: values.filter(pl.Series(rows)) for name, values in self._columns.items()},
            self.file,
            where=self.where,
            place=self._place,
            numbers=numbers[rows],
            sha256=self.sha256,
            notes=self.notes,
        )
        found.header, found.about, found.motion = header, self.about, self.motion
        return found

    def times(self, name: str, unit: str) -> Times:
        """Return a column of times (n,) in ns; `unit` is the unit in the file: s, ms, us or ns.

        Decimal text is converted exactly, then rounded to the nearest ns. Dates are ns since 1970 UTC.

        Raises:
            InputError: on a value that is not a time, or is less than the previous one.
        """
        column = self._columns[name]
        must_be = "a whole number of ns" if unit == "ns" else f"a time in {unit}"
        numbers = _nanoseconds(column, unit)
        self.check(name, numbers.is_not_null().to_numpy(), must_be)
        times: Times = numbers.to_numpy()
        order = f"no less than in the {self._place} before"
        self.check(name, np.diff(times, prepend=times[0]) >= 0, order)
        return times

    def timed(self, name: str, unit: str) -> "TraceTable":
        """Return the rows that have a time in a column; the others are left out with a note."""
        known = _nanoseconds(self._columns[name], unit).is_not_null()
        if known.all():
            return self
        found = self.selected(known.to_numpy())
        found.notes = (*self.notes, f"{len(self) - len(found)} rows without a time left out")
        return found

    def reals(self, name: str, *, lenient: bool = False) -> Reals:
        """Return a column of numbers (n,); NaN for a missing value.

        Args:
            name: Name of the column.
            lenient: Other values are missing too; otherwise they are errors.

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
        good: Flags = np.isfinite(values)
        if lenient:
            values[~good] = np.nan
        else:
            self.check(name, good | ~given, "a number or empty")
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
        expected = f"one of {', '.join(values)}"
        self.check(name, codes.is_not_null().to_numpy(), expected)
        return codes.to_numpy()

    def check(self, name: str, good: Flags, must_be: str) -> None:
        """Require that every value of a column is good.

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
            number = row if self._numbers is None else self._numbers[row]
            where = f"{self.where}, {self._place} {number}, column {name}"
            raise InputError(where, f"is {text:.40}, must be {must_be}")


def check_size(where: str, size: int, rows: int, unit: str = "rows") -> None:
    """Check the size of unpacked columns.

    Args:
        where: Name of the table in messages.
        size: Size, bytes; `VALUE_SIZE` for each value.
        rows: Number of rows, to state how many are allowed.
        unit: Word for rows in messages.

    Raises:
        InputError: if it exceeds `LIMIT`.
    """
    if size > LIMIT:
        reason = f"unpacks to more than {LIMIT >> 20} MiB, the limit ({VALUE_SIZE} bytes for each value)"
        raise InputError(where, f"{reason}: split it into files of at most {rows * LIMIT // size:,} {unit}")


def _series(where: str, name: str, values: Values) -> pl.Series:
    """Return a column whose values polars can convert."""
    if isinstance(values, np.ndarray):
        kind = values.dtype.kind
        if values.ndim != 1 or kind not in "biufUM":
            reason = f"is an array {values.shape} of {values.dtype}, must be (n,) numbers, texts or dates"
            raise InputError(f"{where}, column {name}", reason)
        if kind == "f" and values.dtype.itemsize not in (4, 8):
            values = values.astype(np.float64)
        elif kind == "M":
            values = values.astype("datetime64[ns]")
        elif not values.dtype.isnative:
            values = values.astype(values.dtype.newbyteorder("="))
    try:
        column = values if isinstance(values, pl.Series) else pl.Series(name, values)
    except (TypeError, ValueError, OverflowError, pl.exceptions.PolarsError) as error:
        raise InputError(f"{where}, column {name}", f"has values of several types: {error}") from None
    if isinstance(column.dtype, pl.Categorical | pl.Enum):
        column = column.cast(pl.String)
    elif isinstance(column.dtype, pl.Null):
        column = column.cast(pl.Float64)
    elif column.dtype.is_nested() or isinstance(column.dtype, pl.Object | pl.Binary):
        reason = f"has values of type {column.dtype}, must have numbers, texts or dates"
        raise InputError(f"{where}, column {name}", reason)
    return column


def _nanoseconds(column: pl.Series, unit: str) -> pl.Series:
    """Return times as whole ns; null for other values."""
    if column.dtype == pl.String and column.filter(column != "").head(1).str.contains(_DATE).any():
        column = column.str.to_datetime(time_unit="ns", strict=False)
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


def _rounded(column: pl.Series, unit: str) -> pl.Series:
    with np.errstate(over="ignore"):
        values = column.cast(pl.Float64).fill_null(np.nan).to_numpy() * UNITS[TIME][unit]
    if unit == "ns":
        values = np.where(values == np.rint(values), values, np.nan)
    good = np.abs(values) < _TIME_LIMIT
    whole = pl.Series(np.rint(np.where(good, values, 0)).astype(np.int64))
    return whole.zip_with(pl.Series(good), pl.Series([None], dtype=pl.Int64).new_from_index(0, len(whole)))

"""Strict reader of CSV columns; errors name the line and the column."""

import csv
import hashlib
import io
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from operators.errors import InputError, os_error_reason

LIMIT: Final = 1 << 30  # bytes of a file

_DIGITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}  # decimal places of a time, down to 1 ns


class CsvTable:
    """Columns of a CSV file, converted from text on request.

    Attributes:
        where: Name of the file in messages.
        names: Names of the columns; polars renames a duplicate to end in ``_duplicated_0``.
        sha256: Checksum of the file, hex.
    """

    def __init__(self, path: Path) -> None:
        """Read a file.

        Raises:
            InputError: if it cannot be read, is too large or is not a table.
        """
        self.where = str(path)
        try:
            with path.open("rb") as file:
                content = file.read(LIMIT + 1)
        except OSError as error:
            raise InputError(self.where, f"cannot be read: {os_error_reason(error)}") from None
        if len(content) > LIMIT:
            raise InputError(self.where, f"is larger than {LIMIT >> 20} MiB; cut it into several traces")
        self.sha256 = hashlib.sha256(content).hexdigest()
        try:
            frame = pl.read_csv(content, infer_schema=False)
        except pl.exceptions.NoDataError:
            raise InputError(self.where, "is empty: its first line must name the columns") from None
        except pl.exceptions.PolarsError as error:
            if line := _too_long(content):
                raise InputError(
                    f"{self.where}, line {line}",
                    "has more fields than line 1 has names; a comma in a value needs quotes",
                ) from None
            raise InputError(self.where, f"is not a CSV file: {str(error).splitlines()[0]}") from None
        torn = frame.select(pl.any_horizontal(pl.all().str.contains("\n", literal=True))).to_series()
        for row in torn.arg_true()[:1]:  # an unpaired quotation mark
            raise InputError(
                f"{self.where}, line {row + 2}",
                "has a quoted field that spans lines: close its quotation mark",
            )
        self.names = [name.strip() for name in frame.columns]
        frame = frame.select(pl.all().str.strip_chars())
        filled = ~frame.select(pl.all_horizontal(pl.all().is_null())).to_series()
        self._columns = dict(zip(self.names, frame.filter(filled).get_columns(), strict=True))
        self._lines = np.flatnonzero(filled.to_numpy()) + 2  # (n,) line numbers
        if not len(self._lines):
            raise InputError(self.where, "has no rows below its first line")

    def __len__(self) -> int:
        return len(self._lines)

    def times(self, name: str, unit: str) -> NDArray[np.int64]:
        """Return a column of times (n,) in ns; `unit` is the unit in the file: s, ms, us or ns.

        Decimal text is converted exactly, then rounded to the nearest ns.

        Raises:
            InputError: on a value that is not a time, or is less than the previous one.
        """
        column = self._columns[name]
        if unit == "ns":
            numbers, must_be = column.cast(pl.Int64, strict=False), "a whole number of ns"
        else:
            decimals = column.cast(pl.Decimal(38, _DIGITS[unit]), strict=False)
            numbers, must_be = decimals.to_physical().cast(pl.Int64, strict=False), f"a time in {unit}"
        self._check(name, numbers.is_not_null().to_numpy(), must_be)
        times = numbers.to_numpy()
        self._check(name, np.diff(times, prepend=times[0]) >= 0, "no less than in the line before")
        return times

    def reals(self, name: str) -> NDArray[np.float64]:
        """Return a column of numbers (n,); NaN for an empty field.

        Raises:
            InputError: on a value that is not a finite number.
        """
        column = self._columns[name]
        values = column.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
        present = (column.is_not_null() & (column != "")).to_numpy()  # "": a quoted empty field
        self._check(name, np.isfinite(values) | ~present, "a number or empty")
        return values

    def whole(self, name: str, least: int, greatest: int) -> NDArray[np.float64]:
        """Return a column of whole numbers (n,).

        Raises:
            InputError: on a value that is not a whole number from `least` to `greatest`.
        """
        values = self._columns[name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
        good = (values == np.rint(values)) & (values >= least) & (values <= greatest)
        self._check(name, good, f"a whole number from {least} to {greatest}")
        return values

    def _check(self, name: str, good: NDArray[np.bool_], must_be: str) -> None:
        if not good.all():
            row = int(np.argmin(good))
            found = self._columns[name][row]
            where = f"{self.where}, line {self._lines[row]}, column {name}"
            raise InputError(where, f"is {found or ''!r:.40}, must be {must_be}")


def _too_long(content: bytes) -> int:
    """Return the number of the first line with more fields than line 1; 0 if there is none."""
    rows = csv.reader(io.StringIO(content.decode("utf-8-sig", "replace"), newline=""))
    try:
        width = len(next(rows))
        return next((rows.line_num for row in rows if len(row) > width), 0)
    except csv.Error:
        return 0

"""Reading the columns of a CSV file, strictly: a value that cannot be used is named by line and column."""

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

_DIGITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}  # of a time that count, after the point


class CsvTable:
    """The columns of a CSV file, as text until one is asked for.

    Attributes:
        where: what the file is called in messages.
        names: names of the columns; one that is there twice has a second name ending in ``_duplicated_0``.
        sha256: of the file, hex.
    """

    def __init__(self, path: Path) -> None:
        """Read a file.

        Raises:
            InputError: if it cannot be read, is too large or is no table.
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
            raise InputError(self.where, "is empty, its first line must name the columns") from None
        except pl.exceptions.PolarsError as error:
            if line := _too_long(content):
                raise InputError(
                    f"{self.where}, line {line}",
                    "has more fields than line 1 has names; a comma in a value needs quotes",
                ) from None
            raise InputError(self.where, f"is no CSV file: {str(error).splitlines()[0]}") from None
        torn = frame.select(pl.any_horizontal(pl.all().str.contains("\n", literal=True))).to_series()
        for row in torn.arg_true()[:1]:  # else a stray quotation mark would swallow lines
            raise InputError(
                f"{self.where}, line {row + 2}",
                "has a quoted field that spans lines: close its quotation mark",
            )
        self.names = [name.strip() for name in frame.columns]
        frame = frame.select(pl.all().str.strip_chars())
        filled = ~frame.select(pl.all_horizontal(pl.all().is_null())).to_series()
        self._columns = dict(zip(self.names, frame.filter(filled).get_columns(), strict=True))
        self._lines = np.flatnonzero(filled.to_numpy()) + 2  # (n,) numbers of the lines after the header
        if not len(self._lines):
            raise InputError(self.where, "has no rows below its first line")

    def __len__(self) -> int:
        return len(self._lines)

    def times(self, name: str, unit: str) -> NDArray[np.int64]:
        """A column of times that never decrease (n,), in ns; `unit` is that of the file: s, ms, us or ns.

        Decimal text becomes ns exactly, rounded to the nearest.

        Raises:
            InputError: naming the line of the first value that is none.
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
        """A column of numbers (n,); NaN where a row has none.

        Raises:
            InputError: naming the line of the first value that is not a finite number.
        """
        column = self._columns[name]
        values = column.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
        told = (column.is_not_null() & (column != "")).to_numpy()  # "" is what was quoted
        self._check(name, np.isfinite(values) | ~told, "a number, or nothing")
        return values

    def whole(self, name: str, least: int, greatest: int) -> NDArray[np.float64]:
        """A column of whole numbers (n,).

        Raises:
            InputError: naming the line of the first value that is none, or not from `least` to `greatest`.
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
    """Number of the first line that has more fields than the first line; 0 if none has."""
    rows = csv.reader(io.StringIO(content.decode("utf-8-sig", "replace"), newline=""))
    try:
        width = len(next(rows))
        return next((rows.line_num for row in rows if len(row) > width), 0)
    except csv.Error:
        return 0

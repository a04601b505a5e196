"""Reading the columns of a CSV file, strictly: a value that cannot be used is named by line and column."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from operators.errors import InputError


class CsvTable:
    """The columns of a CSV file, as text until one is asked for."""

    def __init__(self, path: Path) -> None:
        """Read a file.

        Raises:
            InputError: if it cannot be read or is no table.
        """
        self._where = str(path)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InputError(self._where, f"cannot be read: {error.strerror}") from None
        try:
            frame = pl.read_csv(content, infer_schema=False)
        except pl.exceptions.NoDataError:
            raise InputError(self._where, "is empty") from None
        except pl.exceptions.PolarsError as error:
            if line := _too_long(content):
                raise InputError(f"{self._where}, line {line}", "has more fields than line 1") from None
            raise InputError(self._where, f"is no CSV file: {str(error).splitlines()[0]}") from None
        torn = frame.select(pl.any_horizontal(pl.all().str.contains("\n", literal=True))).to_series()
        for row in torn.arg_true()[:1]:  # else a stray quotation mark would swallow lines
            raise InputError(f"{self._where}, line {row + 2}", "has a quoted field that spans lines")
        self.names = [name.strip() for name in frame.columns]
        frame = frame.select(pl.all().str.strip_chars())
        filled = ~frame.select(pl.all_horizontal(pl.all().is_null())).to_series()
        self._columns = dict(zip(self.names, frame.filter(filled).get_columns(), strict=True))
        self._lines = np.flatnonzero(filled.to_numpy()) + 2  # (n,) numbers of the lines after the header
        if not len(self._lines):
            raise InputError(self._where, "has no rows")

    def choose(self, choices: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
        """The first of several choices of columns that is there.

        Raises:
            InputError: if none is, or a column is there twice.
        """
        for names in choices:
            if set(names) <= set(self.names):
                for name in names:
                    if self.names.count(name) > 1 or f"{name}_duplicated_0" in self.names:  # so says polars
                        raise InputError(f"{self._where}, line 1", f"has two columns {name}")
                return names
        wanted = " or ".join(" ".join(names) for names in choices)
        reason = f"has the columns {' '.join(self.names)!r:.200}, must have {wanted}"
        raise InputError(f"{self._where}, line 1", reason)

    def times(self, name: str) -> NDArray[np.int64]:
        """A column of times that never decrease (n,), in ns, given in ns if its name ends so, else in s.

        Raises:
            InputError: naming the line of the first value that is none.
        """
        column = self._columns[name]
        if name.endswith("_ns"):
            numbers, must_be = column.cast(pl.Int64, strict=False), "a whole number of ns"
        else:
            decimals = column.cast(pl.Decimal(38, 9), strict=False)
            numbers, must_be = decimals.to_physical().cast(pl.Int64, strict=False), "a time in s"
        self._check(name, numbers.is_not_null().to_numpy(), must_be)
        times = numbers.to_numpy()
        self._check(name, np.diff(times, prepend=times[0]) >= 0, "no less than in the line before")
        return times

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
            where = f"{self._where}, line {self._lines[row]}, column {name}"
            raise InputError(where, f"is {found or ''!r:.40}, must be {must_be}")


def _too_long(content: bytes) -> int:
    """Number of the first line that has more fields than the first line; 0 if none has."""
    rows = csv.reader(io.StringIO(content.decode("utf-8-sig", "replace"), newline=""))
    try:
        width = len(next(rows))
        return next((rows.line_num for row in rows if len(row) > width), 0)
    except csv.Error:
        return 0

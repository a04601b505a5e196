"""Format of the numbers of a file as a whole: the sign of decimals, and that of thousands."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import is_air
from connectors.files.raw_table import Problems, RawTable

MISSING: Final = ("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--")  # in lower case
_BLANKS: Final = "'\u2019\u00a0\u202f "  # between thousands


@dataclass(frozen=True)
class NumberFormat:
    """Format of numbers in texts.

    Args:
        decimal: Sign of decimals, ``.`` or ``,``. The other one, blanks and apostrophes divide thousands.
    """

    decimal: str = "."

    def plain(self, column: pl.Series) -> pl.Series:
        """Return the texts of a column as Python writes numbers; null for those in another format."""
        return column.to_frame().select(self._plain).to_series() if column.dtype == pl.String else column

    def reals(self, column: pl.Series) -> pl.Series:
        """Return the numbers of a column; NaN for a missing value, null for what is no finite number."""
        text = column.dtype == pl.String
        value = (self._plain if text else pl.first()).cast(pl.Float64, strict=False)
        missing = pl.first().is_null() | value.is_nan().fill_null(value=False)
        if text:
            missing = pl.first().str.to_lowercase().str.strip_chars().is_in(MISSING).fill_null(value=True)
        number = pl.when(missing).then(np.nan).when(value.is_finite()).then(value)
        return column.to_frame().select(number).to_series()

    @cached_property
    def _plain(self) -> pl.Expr:
        sign, other = re.escape(self.decimal), re.escape("," if self.decimal == "." else ".")
        groups = "|".join(rf"\d{{1,3}}(?:{each}\d{{3}})+" for each in (other, f"[{_BLANKS}]"))
        text = pl.first().str.strip_chars().str.replace("\u2212", "-", literal=True)
        bare = text.str.replace_all(rf"[{other}{_BLANKS}]", "").str.replace(self.decimal, ".", literal=True)
        number = text.str.contains(rf"^[+-]?(?:\d*|{groups})(?:{sign}\d*)?(?:[eE][+-]?\d+)?$")
        return pl.when(number).then(bare)


def number_format(table: RawTable, names: Sequence[str], unit: str, problems: Problems) -> NumberFormat:
    """Conclude the format of the numbers in the columns `names`, as a whole.

    101.325 may be a thousand times as much, but not as air pressure in the `unit` kPa.
    """
    if not (texts := [name for name in names if table.columns[name].dtype == pl.String]):
        return NumberFormat()
    proof = {sign: _example(table, texts, _decimals(sign)) for sign in ".,"}
    doubt = {sign: _example(table, texts, _groups_or_decimals(sign)) for sign in ".,"}
    if not any(proof.values()) and any(doubt.values()):  # other columns may tell
        others = [name for name, column in table.columns.items() if column.dtype == pl.String]
        proof = {sign: _example(table, others, _decimals(sign)) for sign in ".,"}
    if all(proof.values()):
        both = " and ".join(proof.values())
        problems.add(
            f"decimals have both point and comma ({both}); state decimal=point or decimal=comma",
            fix="decimal=point",
        )
    if any(proof.values()) or not any(doubt.values()) or (table.separator == "comma" and not doubt[","]):
        return NumberFormat("," if proof[","] else ".")
    sign = "," if doubt[","] else "."
    air = [is_air(float(doubt[sign].split()[-1].replace(",", ".")) * each, unit) for each in (1, 1000)]
    if air[0] == air[1] or all(doubt.values()):
        fix = f"decimal={'comma' if sign == ',' else 'point'}"
        problems.add(
            f"{doubt[sign]} may have decimals or thousands; state decimal=point or decimal=comma", fix=fix
        )
    return NumberFormat(sign if air[0] else "." if sign == "," else ",")


def _example(table: RawTable, names: Iterable[str], pattern: str) -> str:
    """Return a value that matches, with its column; empty if there is none."""
    for name in names:
        column = table.columns[name]
        for value in column.filter(column.str.contains(pattern)).head(1):
            return f"column {name}: {value}"
    return ""


def _decimals(sign: str) -> str:
    """Return the pattern of numbers in which a sign can only be that of decimals."""
    point, other = re.escape(sign), re.escape("," if sign == "." else ".")
    mixed = rf"\d{{1,3}}(?:[{other}{_BLANKS}]\d{{3}})+{point}\d+"
    several = rf"\d{{1,3}}{other}\d{{3}}(?:{other}\d{{3}})+"
    plain = rf"\d*{point}(?:\d{{0,2}}|\d{{4,}})|(?:0\d*|\d{{4,}}|){point}\d{{3}}"
    return rf"^[+-]?(?:{mixed}|{several}|{plain}|\d*{point}\d+[eE][+-]?\d+)(?:[eE][+-]?\d+)?$"


def _groups_or_decimals(sign: str) -> str:
    """Return the pattern of numbers in which a sign may divide decimals or thousands."""
    return rf"^[+-]?[1-9]\d{{0,2}}{re.escape(sign)}\d{{3}}$"

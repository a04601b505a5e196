"""Format of the numbers of a file as a whole: the sign of decimals, and that of thousands."""

import re
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import DATE, LABEL, ColumnMap, is_air
from connectors.files.raw_table import RawTable

MISSING: Final = ("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--")  # in lower case
FEW: Final = 1000  # texts, up to which Python is faster than an expression of Polars
_BLANKS: Final = "'\u2019\u00a0\u202f "  # between thousands


def plain(column: pl.Series, decimal: str) -> pl.Series:
    """Return the texts of a column as Python writes numbers; null for those in another format.

    The sign of decimals is `decimal`, ``.`` or ``,``. The other one, blanks and apostrophes divide thousands.
    """
    if column.dtype != pl.String:
        return column
    simple = _simple(column, decimal)
    return column.to_frame().select(_plain(decimal)).to_series() if simple is None else simple


def reals(column: pl.Series, decimal: str) -> pl.Series:
    """Return the numbers of a column; NaN for a missing value, null for what is no finite number."""
    text = column.dtype == pl.String
    if text and (simple := _simple(column, decimal)) is not None:
        return simple.cast(pl.Float64)
    value = (_plain(decimal) if text else pl.first()).cast(pl.Float64, strict=False)
    missing = pl.first().is_null() | value.is_nan()
    if text:
        missing = pl.first().str.to_lowercase().str.strip_chars().is_in(MISSING).fill_null(value=True)
    found = column.to_frame().select(value.alias("value"), missing.alias("missing"))
    number = pl.when("missing").then(np.nan).when(pl.col("value").is_finite()).then("value")
    return found.select(number).to_series()


def _simple(column: pl.Series, decimal: str) -> pl.Series | None:
    """Return a few texts, as of the newest line of a logger, as by `_plain`, if all have a usual form."""
    usual = re.compile(rf"[+-]?\d{{1,18}}(?:{re.escape(decimal)}\d{{1,18}})?(?:[eE][+-]?\d\d?)?", re.ASCII)
    if len(column) > FEW or not all(text and usual.fullmatch(text) for text in column.to_list()):
        return None
    return pl.Series(column.name, [text.replace(decimal, ".") for text in column.to_list()], pl.String)


@cache
def _plain(decimal: str) -> pl.Expr:
    sign, other = re.escape(decimal), re.escape("," if decimal == "." else ".")
    groups = "|".join(rf"\d{{1,3}}(?:{each}\d{{3}})+" for each in (other, f"[{_BLANKS}]"))
    text = pl.first().str.strip_chars().str.replace("\u2212", "-", literal=True)
    bare = text.str.replace_all(rf"[{other}{_BLANKS}]", "").str.replace(decimal, ".", literal=True)
    number = text.str.contains(rf"^[+-]?(?:\d*|{groups})(?:{sign}\d*)?(?:[eE][+-]?\d+)?$")
    return pl.when(number).then(bare)


def with_decimal(table: RawTable, columns: ColumnMap) -> ColumnMap:
    """Conclude the sign of decimals in the columns of a map, as a whole; a doubt is a problem.

    101.325 may be a thousand times as much, but not as air pressure in kPa.
    """
    used = [name for key, names in columns.columns.items() if key not in (LABEL, DATE) for name in names]
    texts = [name for name in used if table.columns[name].dtype == pl.String]
    proof = {sign: _example(table, texts, _decimals(sign)) for sign in ".,"}
    doubt = {sign: _example(table, texts, rf"^[+-]?[1-9]\d{{0,2}}[{sign}]\d{{3}}$") for sign in ".,"}
    if not any(proof.values()) and any(doubt.values()):  # other columns may tell
        others = [name for name, column in table.columns.items() if column.dtype == pl.String]
        proof = {sign: _example(table, others, _decimals(sign)) for sign in ".,"}
    comma = bool(proof[","])
    if columns.decimal is not None:
        comma = columns.decimal == "comma"
    elif all(proof.values()):
        both = " and ".join(proof.values())
        reason = f"decimals have both point and comma ({both}); state decimal=point or decimal=comma"
        table.add_problem(reason, fix="decimal=point")
    elif any(doubt.values()) and not any(proof.values()) and (table.separator != "comma" or doubt[","]):
        sign = "," if doubt[","] else "."
        number = float(doubt[sign].split()[-1].replace(",", "."))
        decimal, thousands = (is_air(number * each, columns.unit) for each in (1, 1000))
        comma = (sign == ",") == decimal
        if decimal == thousands or all(doubt.values()):
            reason = f"{doubt[sign]} may have decimals or thousands; state decimal=point or decimal=comma"
            table.add_problem(reason, fix=f"decimal={'comma' if sign == ',' else 'point'}")
    table.notes += ["decimal comma"] if comma else []
    return replace(columns, decimal="comma" if comma else "point")


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

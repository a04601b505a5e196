"""Format of the numbers of a file as a whole: the sign of decimals."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import DATE, LABEL, ColumnMap
from connectors.files.raw_table import RawTable

MISSING: Final = ("", "nan", "na", "n/a", "#n/a", "null", "none", "<na>", "-", "--")  # in lower case
_NUMBER: Final = r"^[+-]?[\d.,]*(?:\d[{0}]|[{0}]\d)[\d.,]*(?:[eE][+-]?\d+)?$"  # with a sign
_DECIMAL: Final = r"^[+-]?(?:\d+[{0}]\d*|[{0}]\d+)(?:[eE][+-]?\d+)?$"  # with no other sign
_REMEDY: Final = "remove the signs of thousands (in polars: str.replace_all)"
_DOUBT: Final = r"^[+-]?[1-9]\d{0,2}[.,]\d{3}$"  # may have decimals or thousands


def plain(column: pl.Series, decimal: str) -> pl.Series:
    """Return the texts of a column with a decimal point; null for those with another sign of decimals."""
    if column.dtype != pl.String:
        return column
    text = column.str.strip_chars().str.replace("\u2212", "-", literal=True)
    if decimal == ".":
        return text
    return text.str.replace(".", "no number", literal=True).str.replace(",", ".", literal=True)


def reals(column: pl.Series, decimal: str) -> pl.Series:
    """Return the numbers of a column; NaN for a missing value, null for what is no finite number."""
    value = plain(column, decimal).cast(pl.Float64, strict=False)
    missing = column.is_null() | value.is_nan().fill_null(value=False)
    if column.dtype == pl.String:
        missing |= column.str.strip_chars().str.to_lowercase().is_in(MISSING).fill_null(value=False)
    return value.set(value.is_infinite(), None).set(missing, np.nan)


def with_decimal(table: RawTable, columns: ColumnMap) -> ColumnMap:
    """Conclude the sign of decimals in the columns of a map, as a whole; a doubt is a problem."""
    if columns.decimal is None:
        used = [name for key, names in columns.columns.items() if key not in (LABEL, DATE) for name in names]
        signs = {sign: _example(table, used, _NUMBER.format(sign)) for sign in ".,"}
        comma = bool(signs[","])
        sign, decimal = (",", "comma") if comma else (".", "point")
        twice = _example(table, used, r"^[+-]?\d+(?:\.\d{3}\.\d{3}|,\d{3},\d{3})")
        if found := " and ".join(signs.values()) if all(signs.values()) else twice:
            table.add_problem(f"numbers have both point and comma, or one of them twice ({found}): {_REMEDY}")
            table.stop()
        certain = table.separator == "comma" and not comma
        if signs[sign] and not (certain or _example(table, table.columns, _DECIMAL.format(sign), _DOUBT)):
            unit = " and a unit, as units.counts=kPa" if columns.has_counts else ""
            text = f"{signs[sign]} may have decimals or thousands; state decimal={decimal}{unit}"
            table.add_problem(f"{text}, or {_REMEDY}")
        columns = replace(columns, decimal=decimal)
    table.notes += ["decimal comma"] if columns.decimal == "comma" else []
    return columns


def _example(table: RawTable, names: Iterable[str], pattern: str, other: str = "^$") -> str:
    """Return a text that matches one pattern and not the other, with its column; empty: there is none."""
    for name in names:
        if (column := table.columns[name]).dtype == pl.String:
            for value in column.filter(column.str.contains(pattern) & ~column.str.contains(other)).head(1):
                return f"column {name}: {value}"
    return ""

"""Format of the times of a file as a whole: numbers with a unit, dates, or times of day."""

import re
from calendar import month_abbr
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from connectors.files.column_map import TIME, UNITS
from connectors.files.number_format import NumberFormat
from connectors.files.raw_table import Problems, RawTable

_MONTH, _MINUTES, _CENTURY = 12, 60, 100
_YEARS: Final = (1970, 2262)  # of times in ns
_LIMIT: Final = float(1 << 63)  # ns
_EPOCHS: Final = (9e8, 4.2e9)  # s; from 1998 to 2103
_DIGITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}  # decimal places of a time, down to 1 ns
_MONTHS: Final = {name.lower(): number for number, name in enumerate(month_abbr) if name}
_CLOCK: Final = r"\d{1,2}:\d{2}"
_DAY: Final = (
    r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})|(?P<yy>\d{4})(?P<mm>\d{2})(?P<dd>\d{2})"
    r"|(?P<a>\d{1,2})[-/. ](?P<b>\d{1,2}|[A-Za-z]{3})[-/. ](?P<c>\d{4}|\d{2})|(?P<days>\d+) days?"
)
_TEXT: Final = re.compile(
    rf"^(?:(?:{_DAY})[T_,; ]+)?"
    r"(?:(?P<H>\d{1,2}):(?P<M>\d{2})(?::(?P<S>\d{2})(?:(?:[.,]|:(?P<ms>\d{3}$))(?P<f>\d*))?)?"
    r"|(?P<MM>\d{1,2}):(?P<SS>\d{2})[.,](?P<ff>\d+))"
    r" ?(?P<p>[AaPp][Mm])? ?(?P<z>Z|UTC|GMT|[+-]\d{2}:?\d{2})?$"
)


def epoch_unit(values: pl.Series) -> str:
    """Return the unit in which numbers are times since 1970, by their digits; empty: in none.

    >>> epoch_unit(pl.Series([1742999346123.0])), epoch_unit(pl.Series([5.0]))
    ('ms', '')
    """
    low, high = values.min(), values.max()
    if not isinstance(low, float) or not isinstance(high, float):
        return ""
    for unit in _DIGITS:
        if all(_EPOCHS[0] <= each * UNITS[TIME][unit] / 1e9 <= _EPOCHS[1] for each in (low, high)):
            return unit
    return ""


def is_text_of_time(column: pl.Series) -> bool:
    """Return True if the first value of a column is a date or a time of day."""
    if column.dtype != pl.String:
        return False
    filled = column.filter(column != "").head(1)
    return bool(filled.str.contains(rf"{_CLOCK}|^\d{{4}}-\d{{1,2}}-|^\d{{1,2}}[./-]\d{{1,2}}[./-]\d").any())


def date_order(table: RawTable, name: str, problems: Problems) -> str:
    """Conclude the order of day, month and year in the dates of a column: ``ymd``, ``dmy`` or ``mdy``.

    Args:
        table: The table.
        name: Column of dates.
        problems: Gets the problem that day and month cannot be told apart.
    """
    texts = table.columns[name].unique()
    parts = texts.str.extract_groups(
        r"^(\d{1,2})([-/. ])(\d{1,2}|[A-Za-z]{3})[-/. ](\d{4}|\d{2})(?:\D|$)"
    ).struct.unnest()
    parts = parts.drop_nulls()
    if parts.is_empty():
        return "ymd"
    first, second = (parts[each].cast(pl.Int64, strict=False) for each in ("1", "3"))
    short = (parts["4"].str.len_chars() < len("2025")).any() and (parts["2"] != ".").any()
    if second.null_count() or (parts["2"] == ".").all() or (not short and (first > _MONTH).any()):
        return "dmy"
    if not short and (second > _MONTH).any():
        return "mdy"
    if short or (first != second).any():
        doubt = f"column {name}: {texts.drop_nulls()[0]!r:.40} may begin with the day or the month"
        problems.add(f"{doubt}; state dates=dmy or dates=mdy")
    return "dmy"


def nanoseconds(column: pl.Series, unit: str, order: str, numbers: NumberFormat) -> pl.Series:
    """Return times (n,) as whole ns; null for what is no time.

    Decimal texts are converted exactly, then rounded to the nearest ns. Dates are ns since 1970 UTC.

    Args:
        column: The times.
        unit: Unit of numbers.
        order: Order in dates.
        numbers: Format of numbers.
    """
    kind = column.dtype
    if is_text_of_time(column):
        return _of_texts(column, order)
    if kind.is_temporal():
        wanted = kind if kind == pl.Time else pl.Duration("ns") if kind == pl.Duration else pl.Datetime("ns")
        return column.cast(wanted, strict=False).to_physical()
    column = numbers.plain(column)
    if kind.is_float() or unit not in _DIGITS:
        return _rounded(column.cast(pl.Float64, strict=False), unit)
    if unit == "ns":
        return column.cast(pl.Int64, strict=False)
    decimals = column.cast(pl.Decimal(38, _DIGITS[unit]), strict=False)
    return decimals.to_physical().cast(pl.Int64, strict=False)


def _rounded(column: pl.Series, unit: str) -> pl.Series:
    """Return times of floating point as whole ns; null for other values."""
    with np.errstate(over="ignore", invalid="ignore"):
        values = column.fill_null(np.nan).to_numpy() * UNITS[TIME][unit]
    if unit == "ns":
        values = np.where(values == np.rint(values), values, np.nan)
    good = np.abs(values) < _LIMIT
    whole = pl.Series(np.rint(np.where(good, values, 0)).astype(np.int64))
    return whole.set(~pl.Series(good), None)


def _of_texts(column: pl.Series, order: str) -> pl.Series:
    """Return dates and times of day as ns; null for other texts, and for days that do not exist."""
    parts = column.str.strip_chars().str.extract_groups(_TEXT.pattern).struct.unnest()

    def number(*names: str) -> NDArray[np.int64]:
        """Return the numbers of groups of which one at most is filled; 0: none is."""
        given = [parts[name].cast(pl.Int64, strict=False).fill_null(0) for name in names]
        found: NDArray[np.int64] = np.sum([each.to_numpy() for each in given], axis=0, dtype=np.int64)
        return found

    words = parts["b"].str.to_lowercase().replace_strict(_MONTHS, default=None, return_dtype=pl.Int64)
    named = words.fill_null(0).to_numpy()
    first, second = number("a"), number("b") + named
    day, month = (second, first) if order == "mdy" and not named.any() else (first, second)
    year = number("y", "yy", "c")
    year += 2000 * ((number("c") > 0) & (year < _CENTURY))
    iso = pl.DataFrame({"y": year, "m": number("m", "mm") + month, "d": number("d", "dd") + day})
    dates = iso.select(pl.format("{}-{}-{}", *(pl.col(each).cast(pl.String).str.zfill(2) for each in "ymd")))
    days = dates.to_series().str.to_date("%Y-%m-%d", strict=False).to_physical()
    half = (
        parts["p"].str.to_lowercase().replace_strict({"pm": 12, "am": 0}, default=-1, return_dtype=pl.Int64)
    )
    afternoon = half.fill_null(-1).to_numpy()  # 12, 0 or, without am and pm, -1
    hours = np.where(afternoon < 0, number("H"), number("H") % 12 + afternoon)
    digits = (parts[each].fill_null("") for each in ("f", "ff", "ms"))
    fraction = (
        sum(digits, start=pl.Series([""])).str.slice(0, 9).str.pad_end(9, "0").cast(pl.Int64).to_numpy()
    )
    zone = parts["z"].str.extract_groups(r"([+-])(\d{2}):?(\d{2})").struct.unnest()
    east = [zone[each].cast(pl.Int64).fill_null(0).to_numpy() for each in ("2", "3")]
    shift = (east[0] * 60 + east[1]) * np.where(
        (zone["1"] == "-").fill_null(value=False).to_numpy(), -1, 1
    )  # min
    total = np.where(year > 0, days.fill_null(0).to_numpy(), number("days")) * 24 + hours
    minutes, seconds = number("M", "MM"), number("S", "SS")
    total = ((total * 60 + minutes - shift) * 60 + seconds) * 1_000_000_000 + fraction
    good = (
        (parts["M"].is_not_null() | parts["MM"].is_not_null()).to_numpy()
        & (minutes < _MINUTES)
        & (seconds <= _MINUTES)
    )
    good &= number("H") <= np.where(afternoon < 0, 23, 12)
    good &= (days.is_not_null().to_numpy() & (year >= _YEARS[0]) & (year < _YEARS[1])) | (year == 0)
    return pl.Series(total).set(~pl.Series(good), None)

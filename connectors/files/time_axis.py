"""Times of a recording: format, unit, resolution, clocks that wrap or start again, and parts."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise, product
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from connectors.files.column_map import DATE, TIME, UNITS, ColumnMap
from connectors.files.number_format import plain, reals
from connectors.files.raw_table import RawTable
from operators.batch import Times, s
from operators.fingertip import RATE_TOLERANCE, rows_per_second

Parts: TypeAlias = tuple[tuple[int, int], ...]  # first row of each part, and the row after its last

SLOWEST: Final = 5.0  # Hz; a rate outside these limits is implausible
FASTEST: Final = 5000.0  # Hz

_ENOUGH: Final = 10  # rows from which on a rate is judged
_COARSE: Final = 0.1  # largest share of the rows that one time may have
_SHOWN: Final = 5  # parts in an error
_MOST: Final = 1000  # wraps in a file, or rows out of order
_LOST: Final = 2.0  # largest ratio of a stated rate and that of the rows, of which some may be lost
_ROUNDED: Final = 3  # missing samples that may come from rounded times
_NEAR: Final = 20  # usual intervals, of the step over a wrap; a longer step is a pause
_WRAPS: Final[Mapping[int, str]] = {  # ns: after which clocks start again at 0
    4_294_967_296_000: "32-bit clock of microseconds",
    4_294_967_296_000_000: "32-bit clock of milliseconds",
    65_536_000_000: "16-bit clock of milliseconds",
    86_400_000_000_000: "time of day",
}
_EPOCHS: Final = (9e8, 4.2e9)  # s; from 1998 to 2103
_DIGITS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}  # decimal places of a time, down to 1 ns
CLOCK: Final = r"\d{1,2}:\d{2}"
_TEXT: Final = rf"{CLOCK}|^\d{{4}}-\d{{1,2}}-|^\d{{1,2}}[./-]\d{{1,2}}[./-]\d"
_FORMS: Final = {  # that texts of times are brought into before they are parsed
    r"^(\d{1,4})[-/. ](\d{1,2}|[A-Za-z]{3})[-/. ](\d{1,4})[T_,; ]+": "${1}-${2}-${3} ",
    rf"^({CLOCK}(?::|$| ))": "1970-01-01 ${1}",
    r"(:\d{2}),(\d)": "${1}.${2}",
    r" ?(?:Z|UTC|GMT)$": "+00:00",
    r"(:[\d.]+) ?([+-]\d\d)$": "${1}${2}:00",
}
_ORDERS: Final = {"ymd": "%Y-%m-%d", "dmy": "%d-%m-%Y", "mdy": "%m-%d-%Y"}
_CLOCKS: Final = ("%H:%M:%S%.f", "%I:%M:%S%.f %p", "%H:%M", "%I:%M %p")
_DATE: Final = "a date and time such as 2025-03-26 14:29:06.01 (or state time=,rate=...)"
_DAYS: Final = r"^(-?\d{1,5}) days?,? \+?"  # of a duration, as pandas and Python write it
_YEAR: Final = r"(?:^|-)(?:19[7-9]\d|2[01]\d\d|22[0-5]\d|226[01])[- ]"  # of times in ns


def time_axis(table: RawTable, columns: ColumnMap, *, split: bool) -> tuple[ColumnMap, Times, Parts]:
    """Conclude the times (n,) of a table, ns; with `split`, a clock that starts again begins another part.

    The map gets the unit of the time, the order in dates and the rate. Problems are invalid times, a unit
    that is not stated, and times that cannot tell the rate.
    """
    unknown: Times = np.zeros(len(table), np.int64)
    if TIME not in columns.columns:
        if columns.rate is None:  # which is a problem
            return columns, unknown, ()
        table.notes.append("times by the rate")
        time = np.rint(np.arange(len(table)) * (s / columns.rate)).astype(np.int64)
        return replace(columns, dates="ymd"), time, _parts(table, "", time, split=split)
    [name], dates = columns.columns[TIME], columns.columns.get(DATE)
    column = table.columns[name]
    if dates:
        clock = column.dt.to_string("%H:%M:%S%.9f") if column.dtype == pl.Time else column.cast(pl.String)
        column = table.columns[dates[0]].cast(pl.String).str.replace(rf"([T_,; ]+{CLOCK}.*)?$", " ") + clock
    texts = is_text_of_time(column)
    textual = texts or column.dtype.is_temporal()
    order = columns.dates or (date_order(table, (dates or [name])[0]) if texts else "ymd")
    stated = "s" if textual else columns.units.get(TIME, "")
    epoch = "" if stated else _epoch_unit(reals(column, columns.decimal_sign).drop_nans())
    table.notes += [f"time in {epoch} since 1970, by its digits"] if epoch else []
    unit = stated or epoch or "s"
    columns = replace(columns, units={**columns.units, TIME: unit}, dates=order)
    raw = of_texts(column, order) if texts else of_numbers(column, columns)
    what = "a whole number of ns" if unit == "ns" else _DATE if textual else f"a time in {unit}"
    table.check(name, raw.is_not_null().to_numpy(), what)
    if raw.null_count():
        return columns, unknown, ()
    time = continued(raw.to_numpy(), table.notes)
    parts = _parts(table, name, time, split=split)
    rate = _rate(table, name, time, parts, columns.rate)
    plausible = rate is None or SLOWEST <= rate <= FASTEST
    if rate and not (plausible or stated) and (split or len(parts) == 1):
        _add_unit_problem(table, name, rate, unit)
    if not plausible:
        table.warn(f"the rate is {rate:.4g} Hz: is the time in another unit?")
    if columns.rate and rate and abs(rate - columns.rate) > RATE_TOLERANCE * columns.rate:
        usual = float(np.quantile(np.diff(time), 0.25))  # of a stated rate, unless the clock has another one
        gaps = usual * columns.rate < (1 + RATE_TOLERANCE) * s
        add = table.warn if gaps and columns.rate / _LOST < rate < columns.rate else table.add_problem
        add(f"has {rate:.4g} rows per second, not {columns.rate:g}: wrong unit of the time, or lost rows?")
    columns = replace(columns, rate=columns.rate or rate)
    for start, stop in parts if columns.rate else ():
        part = time[start:stop]
        _warn_of_gaps(table, part, start, rows_per_second(part) or columns.rate or 1.0)
    return columns, time, parts


def _warn_of_gaps(table: RawTable, time: Times, start: int, rate: float) -> None:
    """Warn of pauses and of missing samples in the times (n,) of the part that begins with row `start`."""
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0  # longer, if rows share times
    pauses = steps > max(_NEAR * s / rate, s / 4, 2 * usual)
    if several := int(np.count_nonzero(pauses)):
        first, longest = table.numbers[start + np.argmax(pauses)], steps[pauses].max() / s
        table.warn(f"pauses: {several}, up to {longest:.1f} s, the first after {table.place} {first}", start)
    expected = round(float(steps[~pauses].sum()) * rate / s) + several
    if (missing := expected - len(steps)) > _ROUNDED:
        table.warn(f"{missing} of {expected + 1} samples are missing", start)


def continued(time: Times, notes: list[str]) -> Times:
    """Return times (n,) whose clock goes on where it wrapped, such as micros() of an Arduino, and note it."""
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    for row in np.flatnonzero(steps < 0)[:_MOST]:
        for span, clock in _WRAPS.items():
            if 0 <= steps[row] + span <= _NEAR * usual:
                steps[row] += span
                notes.append(f"the {clock} wrapped after row {row + 1}: continued")
                break
    found: Times = time[0] + np.concatenate(([0], np.cumsum(steps)))
    return found


def _add_unit_problem(table: RawTable, name: str, rate: float, unit: str) -> None:
    """Add the problem that the unit of the time is not stated, and the concluded one is implausible."""
    tried = ("s", "ms", "us", "ns", "min")
    others = {each: rate * UNITS[TIME][unit] / UNITS[TIME][each] for each in tried if each != unit}
    likely = [f"units.time={each} ({hz:.4g} Hz)" for each, hz in others.items() if SLOWEST <= hz <= FASTEST]
    if len(table) >= _ENOUGH:
        reason = f"column {name} has no unit, in {unit} its rate is {rate:.4g} Hz"
        remedy = " or ".join(likely) or "another unit (convert days with polars)"
        fix = likely[0].partition(" ")[0] if likely else None
        if rate == 1:
            remedy, fix = f"time=,rate=... (if it counts rows) or {remedy}", "time=,rate=ROWS_PER_SECOND"
        table.add_problem(f"{reason}; state {remedy}, or units.time={unit}", fix=fix)


def _parts(table: RawTable, name: str, time: Times, *, split: bool) -> Parts:
    """Return the parts, each with a clock that never goes back; without `split`, several are a problem."""
    back = np.flatnonzero(np.diff(time) < 0) + 1
    parts = tuple(pairwise([0, *back.tolist(), len(time)]))
    strays = [row for row in (_stray(time, row) for row in back[:_MOST].tolist()) if row]
    strays = strays or [start for start, stop in parts[1:] if stop - start == 1]
    sizes = ", ".join([*(str(stop - start) for start, stop in parts[:_SHOWN]), "..."][: len(parts)])
    must_be = f"no less than in the {table.place} before; if the logger started again,"
    must_be += f" --split makes {len(parts)} sessions ({sizes} rows)"
    if strays or not split:
        must_be = "in order: sort the rows by time, or delete this one" if strays else must_be
        table.check(name, ~np.isin(np.arange(len(time)), strays or back), must_be)
    return parts


def _stray(time: Times, back: int) -> int | None:
    """Return the row out of order where the clock goes `back` but then on; None: it starts again."""
    before, after = time[back - 1], time[back : back + 3]
    if len(after) > 2 and after[0] <= time[max(back - 2, 0)] and after[2] - after[1] == after[1] - after[0]:
        return None  # it goes on from there
    if np.any(after[1:] > before):
        return back
    return back - 1 if back > 1 and after[0] > time[back - 2] else None


def _rate(table: RawTable, name: str, time: Times, parts: Parts, stated: float | None) -> float | None:
    """Return the rows per second of the longest part; times without resolution are a problem."""
    start, stop = max(parts, key=lambda part: part[1] - part[0])
    part = time[start:stop]
    shared = np.unique_counts(part)
    most, values = int(shared.counts.max()), len(shared.values)
    rate = rows_per_second(part)
    coarse = len(part) / values > max(2.0, (rate or 0.0) / 4)  # steps of more than 0.25 s on average
    if len(part) >= _ENOUGH and (coarse or most > max(2, _COARSE * len(part))):
        step = f", {np.diff(shared.values).min() / s:g} s apart" if values > 1 else ""
        has = f"only {values} value{'s' * (values > 1)} in {len(part)} rows{step}"
        reason = f"column {name} has {has}: it tells no rate; state time=,rate=... (rows per second)"
        table.add_problem(reason, about=TIME, fix="time=" if stated else "time=,rate=ROWS_PER_SECOND")
        return None
    if most > 1:
        text = f"column {name}: {len(part) - values} of {len(part)} rows share the time of the row before"
        table.warn(f"{text} (up to {most} rows); the rate is that of the rows over the time", start)
    return rate


def _epoch_unit(values: pl.Series) -> str:
    """Return the unit in which numbers are times since 1970, by their digits; empty: in none."""
    low, high = values.min(), values.max()
    if not isinstance(low, float) or not isinstance(high, float):
        return ""
    scales = {unit: UNITS[TIME][unit] / UNITS[TIME]["s"] for unit in _DIGITS}
    fits = (unit for unit, each in scales.items() if _EPOCHS[0] <= low * each and high * each <= _EPOCHS[1])
    return next(fits, "")


def is_text_of_time(column: pl.Series, pattern: str = _TEXT) -> bool:
    """Return True if the first value of a column is a text with a pattern: of a date or time of day."""
    texts = column.dtype == pl.String
    return texts and bool(column.filter(column != "").head(1).str.contains(pattern).any())


def date_order(table: RawTable, name: str) -> str:
    """Conclude the order of day, month and year in the dates of a column: ``ymd``, ``dmy`` or ``mdy``."""
    texts = table.columns[name].cast(pl.String).unique()
    parts = texts.str.extract_groups(r"^(\d{1,2})([-/. ])(\d{1,2}|[A-Za-z]{3})[-/. ]\d{4}").struct.unnest()
    parts = parts.drop_nulls()
    first, second = (parts[each].cast(pl.Int64, strict=False) for each in ("1", "3"))
    if second.null_count() or (parts["2"] == ".").any() or (first > 12).any():
        return "dmy"
    if (second > 12).any():
        return "mdy"
    if (first != second).any():
        doubt = f"column {name}: {texts.drop_nulls()[0]!r:.40} may begin with the day or the month"
        table.add_problem(f"{doubt}; state dates=dmy or dates=mdy", fix="dates=dmy")
    return "ymd" if parts.is_empty() else "dmy"


def of_numbers(column: pl.Series, columns: ColumnMap) -> pl.Series:
    """Return times (n,) as whole ns; null for what is no number.

    Decimal texts are converted exactly, then rounded to the nearest ns.
    """
    kind, unit = column.dtype, columns.units.get(TIME, "s")
    if kind.is_temporal():
        return column.cast(kind if kind == pl.Time else pl.Datetime("ns"), strict=False).to_physical()
    column = plain(column, columns.decimal_sign)
    if kind.is_float() or unit not in _DIGITS:
        return _rounded(column.cast(pl.Float64, strict=False), unit)
    if unit == "ns":
        return column.cast(pl.Int64, strict=False)
    return column.cast(pl.Decimal(38, _DIGITS[unit]), strict=False).to_physical().cast(pl.Int64, strict=False)


def _rounded(column: pl.Series, unit: str) -> pl.Series:
    """Return times of floating point as whole ns; null for other values."""
    with np.errstate(over="ignore", invalid="ignore"):
        values = column.fill_null(np.nan).to_numpy() * UNITS[TIME][unit]
    if unit == "ns":
        values = np.where(values == np.rint(values), values, np.nan)
    good = np.abs(values) < float(1 << 63)
    whole = pl.Series(np.rint(np.where(good, values, 0)).astype(np.int64))
    return whole.set(~pl.Series(good), None)


def of_texts(column: pl.Series, order: str) -> pl.Series:
    """Return dates (since 1970 UTC), times of day and durations as ns; null for other and impossible ones."""
    text = column.str.strip_chars()
    days = text.str.extract(_DAYS).cast(pl.Int64).fill_null(0)
    text = text.str.replace(_DAYS, "")
    for pattern, form in _FORMS.items():
        text = text.str.replace(pattern, form)
    found = pl.Series([None], dtype=pl.Int64).new_from_index(0, len(text))
    for day, clock, zone in product(("%Y-%m-%d", _ORDERS[order], "%d-%b-%Y"), _CLOCKS, ("", "%z")):
        if found.null_count():
            utc = "UTC" if zone else None
            time = text.str.to_datetime(f"{day} {clock}{zone}", time_unit="ns", time_zone=utc, strict=False)
            found = found.fill_null(time.to_physical())
    return found.set(~text.str.contains(_YEAR), None) + days * (24 * 3600 * s)

"""Times of a recording: unit, resolution, clocks that wrap or start again, and parts."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from connectors.files.column_map import DATE, TIME, UNITS, ColumnMap
from connectors.files.number_format import NumberFormat
from connectors.files.raw_table import Problems, RawTable
from connectors.files.time_format import date_order, epoch_unit, is_text_of_time, nanoseconds
from operators.batch import Times, s
from operators.fingertip import RATE_TOLERANCE, rows_per_second

Parts: TypeAlias = tuple[tuple[int, int], ...]  # first row of each part, and the row after its last

EPISODE: Final = "episode_index"  # of LeRobot
SLOWEST: Final = 5.0  # Hz; a rate outside these limits is implausible
FASTEST: Final = 5000.0  # Hz

_ENOUGH: Final = 10  # rows from which on a rate is judged
_COARSE: Final = 0.1  # largest share of the rows that one time may have
_SHOWN: Final = 5  # parts in an error
_MOST: Final = 1000  # wraps in a file
_NEAR: Final = 20  # usual intervals, of the step over a wrap
_WRAPS: Final[Mapping[int, str]] = {  # ns: after which clocks start again at 0
    4_294_967_296_000: "32-bit clock of microseconds",
    4_294_967_296_000_000: "32-bit clock of milliseconds",
    65_536_000_000: "16-bit clock of milliseconds",
    86_400_000_000_000: "time of day",
}


@dataclass(frozen=True)
class TimeAxis:
    """Times of the rows of a table.

    Args:
        time: (n,) ns; never decreasing within a part.
        parts: First row of each part and the row after its last.
        unit: Unit of numbers.
        dates: Order in dates.
        rate: Rows per second over the time; None: unknown.
        notes: Conclusions.
        warnings: Doubts.
    """

    time: Times
    parts: Parts
    unit: str
    dates: str
    rate: float | None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def time_axis(
    table: RawTable, columns: ColumnMap, numbers: NumberFormat, problems: Problems, *, split: bool
) -> TimeAxis:
    """Conclude the times of a table.

    Args:
        table: The table.
        columns: Map of its columns.
        numbers: Format of its numbers.
        problems: Gets invalid times, a unit that is not stated, and times that cannot tell the rate.
        split: A clock that starts again begins another part.
    """
    notes, warnings = list[str](), list[str]()
    episodes = _episodes(table)
    if TIME not in columns.columns:
        if columns.rate is None:
            return TimeAxis(np.zeros(len(table), np.int64), ((0, len(table)),), "s", "ymd", None)
        time = np.rint(np.arange(len(table)) * (s / columns.rate)).astype(np.int64)
        return TimeAxis(time, episodes, "s", "ymd", columns.rate, ("times by the rate",))
    name = columns.columns[TIME][0]
    column = table.columns[name]
    if dates := columns.columns.get(DATE):
        column = table.columns[dates[0]].cast(pl.String) + " " + column.cast(pl.String)
    textual = is_text_of_time(column) or column.dtype.is_temporal()
    order = columns.dates or (
        date_order(table, dates[0] if dates else name, problems)
        if textual and column.dtype == pl.String
        else "ymd"
    )
    unit = "s" if textual else columns.units.get(TIME) or _unit(column, numbers, notes)
    raw = nanoseconds(column, unit, order, numbers)
    must_be = (
        "a whole number of ns" if unit == "ns" else "a date and time" if textual else f"a time in {unit}"
    )
    problems.check(table, name, raw.is_not_null().to_numpy(), must_be)
    if raw.null_count():
        return TimeAxis(np.zeros(len(table), np.int64), episodes, unit, order, None, tuple(notes))
    time = continued(raw.to_numpy(), notes)
    parts = _parts(table, name, time, problems, split=split)
    rate = _rate(name, time, parts, problems, warnings)
    _check_unit(columns, unit, rate, time, problems, textual=textual or unit != "s" or bool(notes))
    if rate is not None and not SLOWEST <= rate <= FASTEST:
        warnings.append(f"the rate is {rate:.4g} Hz: is the time in another unit?")
    if columns.rate and rate and abs(rate - columns.rate) > RATE_TOLERANCE * columns.rate:
        problems.add(f"has {rate:.1f} rows per second, not {columns.rate:g}: is its time in another unit?")
    return TimeAxis(time, parts, unit, order, rate, tuple(notes), tuple(warnings))


def continued(time: Times, notes: list[str], usual: float | None = None) -> Times:
    """Return times whose clock goes on where it wrapped, such as micros() of an Arduino after 71.6 minutes.

    Args:
        time: (n,) ns.
        notes: Gets a note on each wrap.
        usual: Usual interval, ns (default: the median).
    """
    steps = np.diff(time)
    if not (back := np.flatnonzero(steps < 0)).size:
        return time
    usual = usual or float(np.median(steps[steps > 0])) if np.any(steps > 0) else usual or 0.0
    for row in back[:_MOST]:
        for span, clock in _WRAPS.items():
            if 0 <= steps[row] + span <= _NEAR * usual:
                steps[row] += span
                notes.append(f"the {clock} wrapped after row {row + 1}: continued")
                break
    found: Times = time[0] + np.concatenate(([0], np.cumsum(steps)))
    return found


def _unit(column: pl.Series, numbers: NumberFormat, notes: list[str]) -> str:
    """Return the unit of times since 1970 by their digits; s for others."""
    unit = epoch_unit(numbers.reals(column).drop_nans())
    if unit:
        notes.append(f"time in {unit} since 1970, by its digits")
    return unit or "s"


def _check_unit(
    columns: ColumnMap, unit: str, rate: float | None, time: Times, problems: Problems, *, textual: bool
) -> None:
    """Add a problem if the file does not state the unit of its time, and seconds are implausible."""
    if (
        columns.units.get(TIME)
        or textual
        or rate is None
        or len(time) < _ENOUGH
        or SLOWEST <= rate <= FASTEST
    ):
        return
    others = {each: rate * UNITS[TIME]["s"] / UNITS[TIME][each] for each in ("ms", "us", "ns", "min", "d")}
    likely = [
        f"units.time={each} ({value:.4g} Hz)" for each, value in others.items() if SLOWEST <= value <= FASTEST
    ]
    if likely:
        reason = f"column {columns.columns[TIME][0]} has no unit, in seconds its rate is {rate:.4g} Hz"
        problems.add(f"{reason}; state {' or '.join(likely)}, or units.time={unit}")


def _episodes(table: RawTable) -> Parts:
    """Return the parts of a table with episodes of LeRobot; else one part."""
    column = table.columns.get(EPISODE)
    starts = (
        [0]
        if column is None
        else [0, *(np.flatnonzero(np.diff(column.cast(pl.String).rle_id().to_numpy())) + 1)]
    )
    return tuple((int(a), int(b)) for a, b in pairwise([*starts, len(table)]))


def _parts(table: RawTable, name: str, time: Times, problems: Problems, *, split: bool) -> Parts:
    """Return the parts, each with a clock that never goes back; without `split` only episodes are parts."""
    starts = {start for start, _stop in _episodes(table)}
    back = [int(row) + 1 for row in np.flatnonzero(np.diff(time) < 0) if int(row) + 1 not in starts]
    parts = tuple(pairwise([*sorted(starts | {*back}), len(time)]))
    if back and not split:
        good = np.ones(len(time), np.bool_)
        good[back] = False
        sizes = ", ".join([*(str(stop - start) for start, stop in parts[:_SHOWN]), "..."][: len(parts)])
        must_be = f"no less than in the {table.place} before; if the logger started again,"
        problems.check(table, name, good, f"{must_be} --split makes {len(parts)} sessions ({sizes} rows)")
    return parts


def _rate(name: str, time: Times, parts: Parts, problems: Problems, warnings: list[str]) -> float | None:
    """Return the rows per second of the longest part; times without resolution are a problem."""
    start, stop = max(parts, key=lambda part: part[1] - part[0])
    part = time[start:stop]
    shared = np.unique_counts(part)
    most, values = int(shared.counts.max()), len(shared.values)
    if len(part) >= _ENOUGH and most > max(2, _COARSE * len(part)):
        step = f", {np.diff(shared.values).min() / s:g} s apart" if values > 1 else ""
        has = f"only {values} value{'s' * (values > 1)} in {len(part)} rows{step}"
        problems.add(
            f"column {name} has {has}: it tells no rate; state time=,rate=... (rows per second)", about=TIME
        )
        return None
    if most > 1:
        text = (
            f"{len(part) - values} of {len(part)} rows share the time of the row before (up to {most} rows)"
        )
        warnings.append(f"column {name}: {text}; the rate is that of the rows over the time")
    return rows_per_second(part)

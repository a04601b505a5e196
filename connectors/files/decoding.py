"""Rows of a table as touch, motion and labels, by a map that states all."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import (
    LABEL,
    LABELS,
    MOTIONS,
    ColumnMap,
    layout_text,
)
from connectors.files.number_format import MISSING, NumberFormat
from connectors.files.raw_table import Problems, RawTable
from connectors.files.resolution import COUNT_LIMIT
from connectors.files.roles import label_values
from operators.batch import (
    EVERY,
    STATIC,
    UNKNOWN,
    Codes,
    Counts,
    Flags,
    Motion,
    Reals,
    Times,
    Touch,
)
from operators.errors import ParameterError
from operators.fingertip import TAKKTILE, Fingertip, grid

_WORDS_SHOWN: Final = 5


@dataclass(frozen=True)
class Decoded:
    """Rows of a recording."""

    time: Times  # (n,) ns of the clock of the file: since 1970, or since the start of its device
    touch: Mapping[int, Touch]  # by fingertip
    motion: Motion  # of the arm; no rows if there is none
    labels: Codes  # (n,) 1 slip, 0 static, -1 unknown


def decode(table: RawTable, columns: ColumnMap, time: Times, readings: Reals, problems: Problems) -> Decoded:
    """Return the rows of a table with times (n,) and readings (n, cells) by a map that states all."""
    numbers = NumberFormat(columns.decimal_sign)
    counts, good = counts_of(readings, columns)
    step = columns.resolution or 1.0
    offsets = np.resize(columns.offset or (0,), len(columns.cell_names))
    for cell, (name, offset) in enumerate(zip(columns.cell_names, offsets, strict=True)):
        ends = f"from {(offset - COUNT_LIMIT) * step:g} to {(offset + COUNT_LIMIT) * step:g}"
        problems.check(table, name, good[:, cell], f"{ends} at a resolution of {step:g}")
    touch, first = dict[int, Touch](), 0
    for finger, names in columns.cells.items():
        cells = slice(first, first := first + len(names))
        touch[finger] = columns.kind(
            time,
            counts[:, cells],
            np.zeros_like(counts[:, cells]),
            ~np.isnan(readings[:, cells]),
            finger=finger,
        )
    return Decoded(
        time, touch, _motion(table, columns, time, numbers, problems), _labels(table, columns, problems)
    )


def readings_of(table: RawTable, columns: ColumnMap, numbers: NumberFormat, problems: Problems) -> Reals:
    """Return the readings (n, cells of all fingertips) in their unit; NaN: missing."""
    names = columns.cell_names
    readings = np.full((len(table), len(names)), np.nan)
    for cell, name in enumerate(names):
        values = _reals(table, name, numbers, problems)
        if columns.has_counts:
            fix = "a whole number (or state a unit, as units.counts=kPa, or a resolution)"
            problems.check(table, name, np.isnan(values) | (values == np.rint(values)), fix)
        readings[:, cell] = values
    return readings


def described(columns: ColumnMap) -> Fingertip:
    """Return the fingertip of the counts that a complete map gives; a range becomes counts.

    Raises:
        ParameterError: if the layout does not fit the cells, or the map has no rate.
    """
    cells = len(next(iter(columns.cells.values())))
    layout = columns.layout or (TAKKTILE.layout if cells == TAKKTILE.cells else grid(cells))
    if columns.layout is not None and Fingertip(layout, 1.0).cells != cells:
        must_be = f"of {cells} cells, as many as the counts have"
        raise ParameterError("Trace", "layout", layout_text(layout), must_be)
    if columns.rate is None:
        raise ParameterError("column map", "rate", None, "stated: rows per second")
    resolution, limits = columns.resolution or 1.0, None
    if columns.range is not None:
        middle = np.mean(columns.offset or (0,))
        ends = np.clip(np.rint(np.array(columns.range) / resolution - middle), -COUNT_LIMIT, COUNT_LIMIT)
        limits = int(ends[0]), int(ends[1])
    return Fingertip(layout, columns.rate, columns.unit, resolution, limits)


def _reals(table: RawTable, name: str, numbers: NumberFormat, problems: Problems) -> Reals:
    values = numbers.reals(table.columns[name])
    signs = " with a decimal comma" if numbers.decimal == "," else ""
    problems.check(table, name, values.is_not_null().to_numpy(), f"a number{signs} or empty")
    found: Reals = values.fill_null(np.nan).to_numpy()
    return found


def counts_of(readings: Reals, columns: ColumnMap) -> tuple[Counts, Flags]:
    """Return the counts (n, cells) of readings, 0 for missing ones, and which readings a count can store."""
    counts = np.rint(readings / (columns.resolution or 1.0) - np.array(columns.offset or (0,)))
    good: Flags = ~(np.abs(counts) > COUNT_LIMIT)
    if columns.has_counts:
        good &= np.isnan(readings) | (readings == np.rint(readings))
    return np.nan_to_num(np.clip(counts, -COUNT_LIMIT, COUNT_LIMIT)).astype(np.int16), good


def _motion(
    table: RawTable, columns: ColumnMap, time: Times, numbers: NumberFormat, problems: Problems
) -> Motion:
    """Return the rows with a velocity."""
    velocity: Reals = np.full((len(time), 6), np.nan)
    for name in MOTIONS:
        if names := columns.columns.get(name):
            given = [_reals(table, each, numbers, problems) for each in names]
            velocity = np.pad(np.column_stack(given), ((0, 0), (0, 6 - len(given))))
            velocity[:, :3] *= columns.scale(name)
    moving: Flags = np.all(np.isfinite(velocity), axis=1)
    unknown = np.full((len(time), 6), np.nan)
    return Motion(time, time, velocity, unknown, finger=EVERY)[moving]


def _labels(table: RawTable, columns: ColumnMap, problems: Problems) -> Codes:
    """Return the labels of the rows (n,); other values than the stated or usual ones are a problem."""
    if LABEL not in columns.columns:
        return np.full(len(table), LABELS[columns.labelled or "unknown"], np.int8)
    [name] = columns.columns[LABEL]
    column = table.columns[name]
    numbers = column.cast(pl.Float64, strict=False)
    whole = (numbers == numbers.round()) & (numbers.abs() < 2.0**53)
    text = column.cast(pl.String, strict=False).str.strip_chars().str.to_lowercase()
    if column.dtype != pl.Boolean:
        whole = whole.fill_null(value=False)
        text = text.zip_with(~whole, numbers.set(~whole, None).cast(pl.Int64, strict=False).cast(pl.String))
    codes_of = {value: LABELS[label] for value, label in label_values(columns.labels).items()}
    other = STATIC if set(columns.labels) == {"slip"} else None
    codes = text.replace_strict(codes_of, default=other, return_dtype=pl.Int8)
    codes = codes.set(text.fill_null("").is_in(sorted({*MISSING} - {*codes_of})), UNKNOWN)
    if codes.null_count():
        words = text.filter(codes.is_null()).unique(maintain_order=True).to_list()
        listed = ", ".join(repr(each) for each in words[:_WORDS_SHOWN]) + (
            ", ..." if len(words) > _WORDS_SHOWN else ""
        )
        row = int(codes.is_null().arg_true()[0])
        reason = (
            f"has {listed}, neither slip nor static by usual words; state labels.slip=... (others: static)"
        )
        problems.add(
            reason,
            f"{table.place_of(row)}, column {name}",
            fix=None if columns.labels else f"labels.slip={words[0]}",
        )
    found: Codes = codes.fill_null(UNKNOWN).to_numpy()
    return found

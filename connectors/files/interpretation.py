"""Interpretation of a table: each stage adds its conclusions, and all problems become one error."""

from dataclasses import dataclass, replace

import numpy as np

from connectors.files.column_map import COUNTS, DATE, LABEL, TIME, ColumnMap
from connectors.files.decoding import Decoded, decode, readings_of
from connectors.files.number_format import NumberFormat, number_format
from connectors.files.plausibility import Plausible, plausible
from connectors.files.raw_table import Problems, RawTable
from connectors.files.resolution import is_multiple, offsets, resolution_of
from connectors.files.roles import completed
from connectors.files.time_axis import TimeAxis, time_axis


@dataclass(frozen=True)
class Interpretation:
    """Table whose columns and formats are known."""

    table: RawTable
    columns: ColumnMap  # complete
    stated: frozenset[str]  # quantities that the user mapped; others were recognised by their names
    axis: TimeAxis
    decoded: tuple[Decoded, ...]  # rows of each part
    notes: tuple[str, ...]  # conclusions of all stages
    warnings: tuple[str, ...]  # doubts of all stages


def interpret(table: RawTable, stated: ColumnMap, *, split: bool = False) -> Interpretation:
    """Interpret a table by what the user states; with `split`, a clock that starts again begins another part.

    Raises:
        InputError: that lists all problems, with a map that solves them.
        ParameterError: if the layout or the range does not fit the cells.
    """
    problems = Problems(table.file)
    if not len(table):
        problems.add("has no rows")
    elif not table.columns:
        problems.add("has no columns of numbers or texts")
    problems.stop()
    columns, notes = completed(stated, table, problems)
    used = [name for key, names in columns.columns.items() if key not in (LABEL, DATE) for name in names]
    if columns.decimal is None:
        numbers = number_format(table, used, columns.unit, problems)
    else:
        numbers = NumberFormat(columns.decimal_sign)
    notes += ["decimal comma"] if numbers.decimal == "," else []
    axis = time_axis(table, columns, numbers, problems, split=split)
    columns = replace(
        columns,
        units={**columns.units, **({TIME: axis.unit} if TIME in columns.columns else {})},
        decimal="comma" if numbers.decimal == "," else "point",
        dates=axis.dates,
        rate=columns.rate or axis.rate,
        separator=table.separator,
    )
    readings = readings_of(table, columns, numbers, problems)
    names = columns.cell_names
    for cell in np.flatnonzero(np.isnan(readings).all(axis=0)):
        problems.add(f"column {names[cell]} has no readings")
    if len({len(each) for each in columns.cells.values()}) > 1:
        problems.add("its fingertips have different numbers of cells", about=COUNTS)
    if not names or np.isnan(readings).all(axis=0).any():
        problems.stop()
    checked = plausible(readings, names, axis.time, table, columns)
    columns, rounded = _resolved(columns, checked)
    parts = tuple(
        decode(table.rows(*part), columns, axis.time[slice(*part)], checked.readings[slice(*part)], problems)
        for part in axis.parts
    )
    problems.stop()
    doubts = [*axis.warnings, *checked.warnings]
    if rounded:
        doubts.append(f"the readings are rounded to steps of {columns.resolution:g} {columns.unit}")
    stages = (*table.notes, *notes, *axis.notes, *checked.notes)
    return Interpretation(table, columns, frozenset(stated.columns), axis, parts, stages, tuple(doubts))


def _resolved(columns: ColumnMap, checked: Plausible) -> tuple[ColumnMap, bool]:
    """Return the map with resolution and offsets, and True if a stated resolution rounds the readings."""
    readings = checked.readings
    resolution = columns.resolution or resolution_of(readings, offset=not checked.zeroed)
    rounded = columns.resolution is not None and not is_multiple(readings, columns.resolution)
    offset = columns.offset
    if offset is None and not checked.zeroed and (found := offsets(readings, resolution)).any():
        offset = tuple(int(each) for each in found)
    known = replace(
        columns, resolution=resolution, offset=offset, zeroed=checked.zeroed, missing=checked.missing
    )
    return known, rounded

"""Readings as counts of 16 bits: missing ones, the unloaded start, the resolution and the fingertip."""

from dataclasses import replace
from typing import Final

import numpy as np

from connectors.files.column_map import COUNTS, ColumnMap, layout_text
from connectors.files.number_format import reals
from connectors.files.raw_table import RawTable, listed
from operators.batch import Counts, Flags, Reals, Times, Touch, Zeroed, s
from operators.errors import ParameterError
from operators.fingertip import Fingertip, usual_layout

COUNT_LIMIT: Final = 32767  # largest absolute count

_STEPS: Final = [float(f"{each}e{power}") for power in range(-12, 306) for each in ("1", "2", "2.5", "5")]
_TOLERANCE: Final = 0.01  # of a step, at most
_FLOAT32: Final = 1e-5  # of the largest reading: float32 has 24 bits, of which a subtraction costs some
_PRECISION: Final = 1e-10  # of the largest reading: float64 has 53 bits
_NINES: Final = [float(f"{'9' * whole}.{'9' * part}") for whole in range(2, 8) for part in range(4)]
_SENTINELS: Final = (  # usual values for no reading; 99 to 999.999 may be readings
    *(*(-value for value in _NINES), *_NINES[8:]),
    *(sign * value for value in (1e10, 1e20, 1e30, 1e31, 1e37, 1e38) for sign in (-1, 1)),
    *(-1.0, 32767.0, -32768.0, 65535.0, 2147483647.0, -2147483648.0, 4294967295.0),
)
_MANY, _FEW = 5, 4  # steps between values that become one, and different values of what is no signal any more
_MOVES: Final = 0.25  # of the range of a cell, in the first second
_SAMPLE: Final = 10_000  # rows for quantiles
_ENOUGH: Final = 100  # rows, after which a cell that works has changed
_FAR: Final = 1 << 53  # counts; larger ones are not exact


def readings_of(table: RawTable, columns: ColumnMap) -> tuple[ColumnMap, Counts, Flags]:
    """Return the readings of a table as counts (n, cells), and which are valid.

    The map gets resolution, offset, missing and zeroed. Readings that mean none become invalid.
    """
    names, readings = columns.cell_names, _read(table, columns)
    missing = columns.missing
    if missing is None:
        missing = _sentinels(readings)
        for value in missing:
            row, cell = np.argwhere(readings == value)[0].tolist()
            many, place = int((readings == value).sum()), table.place_of(row, names[cell])
            text = f"{place} is {value:.10g}, far from all others: taken as missing"
            table.warn(f"{text} ({many} in all; missing= keeps it)", row)
        readings[np.isin(readings, missing)] = np.nan
    zeroed = columns.zeroed
    if zeroed is None:
        zeroed = _is_zeroed(readings)
        table.notes += ["readings relative to the unloaded fingertip"] if zeroed else []
    stated = columns.resolution
    given = stated or columns.steps.get(columns.unit)
    resolution = given or resolution_of(readings, offset=not zeroed)
    if given and not _is_multiple(readings, resolution):
        table.warn(f"the readings are rounded to steps of {resolution:g} {columns.unit}")
    offset = columns.offset
    if offset is None and not zeroed and (found := offsets(readings, resolution)).any():
        offset = tuple(map(int, found))
    columns = replace(columns, resolution=resolution, offset=offset, zeroed=zeroed, missing=missing)
    if stated is None:
        _check_signal(table, readings, columns, inherited=given is not None)
    counts = np.rint(readings / resolution - np.array(offset or (0,)))
    good: Flags = ~(np.abs(counts) > COUNT_LIMIT)
    for cell, (name, middle) in enumerate(zip(names, np.resize(offset or 0, len(names)), strict=True)):
        low, high = (middle - COUNT_LIMIT) * resolution, (middle + COUNT_LIMIT) * resolution
        table.check(name, good[:, cell], f"from {low:g} to {high:g} at a resolution of {resolution:g}")
    _warn_of_implausible(table, readings, columns)
    stored = np.nan_to_num(np.clip(counts, -COUNT_LIMIT, COUNT_LIMIT)).astype(np.int16)
    return columns, stored, ~np.isnan(readings)


def _check_signal(table: RawTable, readings: Reals, columns: ColumnMap, *, inherited: bool) -> None:
    """Find cells that the concluded resolution makes constant, or almost constant.

    That is a problem if most cells are: a corrupt reading makes the steps large, or earlier files have larger
    ones. Few cells, which may be pressed less than the others, are a warning.
    """
    names, step, lost = columns.cell_names, columns.resolution or 1.0, list[int]()
    low, middle, high = (_quantiles(readings, share) for share in (0.01, 0.5, 0.99))
    for cell, some in enumerate(readings[:: len(readings) // _SAMPLE + 1].T):
        values = np.unique(some[(low[cell] <= some) & (some <= high[cell])])
        left = len(np.unique(np.rint(values / step)))
        if left < _FEW and len(values) - 1 > _MANY * (left - 1):
            lost.append(cell)
    if not lost:
        return
    row, cell = divmod(int(np.nanargmax(np.abs(readings - middle))), len(names))
    farthest, earlier = repr(float(readings[row, cell])).removesuffix(".0"), ", as in earlier files,"
    remedy = f"state missing={farthest} if {table.place_of(row, names[cell])} is no reading"
    remedy = "import this file first, or into another dataset" if inherited else remedy
    add = table.add_problem if 2 * len(lost) > len(names) else table.warn
    add(
        f"steps of {step:g} {columns.unit}{earlier if inherited else ''} make"
        f" {listed([names[each] for each in lost])} almost constant: {remedy}, or state resolution={step:g}"
    )


def _warn_of_implausible(table: RawTable, readings: Reals, columns: ColumnMap) -> None:
    """Warn of cells that never change, and of readings (n, cells) outside the stated range."""
    cells = zip(columns.cell_names, readings.T, strict=True)
    same = [name for name, cell in cells if np.nanmin(cell) == np.nanmax(cell)]
    if same and len(readings) >= _ENOUGH:
        table.warn(f"all readings of {listed(same)} are the same: is the cell broken?")
    low, high = np.sort(columns.range or (-np.inf, np.inf))
    if not columns.zeroed and (np.nanmin(readings) < low or np.nanmax(readings) > high):
        table.warn(f"readings are outside the stated range, {low:.9g} to {high:.9g}")


def _read(table: RawTable, columns: ColumnMap) -> Reals:
    """Return the readings (n, cells); NaN: missing."""
    names = columns.cell_names
    readings = np.full((len(table), len(names)), np.nan)
    for cell, name in enumerate(names):
        readings[:, cell] = reals_of(table, name, columns)
        if columns.has_counts:
            fix = "a whole number (or state a unit, as units.counts=kPa, or a resolution)"
            table.check(name, ~(readings[:, cell] % 1 > 0), fix)
    readings[np.isin(readings, columns.missing or ())] = np.nan
    empty = np.isnan(readings).all(axis=0)
    for cell in np.flatnonzero(empty).tolist():
        table.add_problem(f"column {names[cell]} has no readings")
    if len({len(each) for each in columns.cells.values()}) > 1:
        table.add_problem("its fingertips have different numbers of cells", about=COUNTS)
    if not names or empty.any():
        table.stop()
    return readings


def reals_of(table: RawTable, name: str, columns: ColumnMap) -> Reals:
    """Return the numbers of a column (n,); NaN for missing ones."""
    values = reals(table.columns[name], columns.decimal_sign)
    signs = " with a decimal comma" if columns.decimal == "comma" else ""
    must_be = f"a number{signs}, without signs of thousands, or empty"
    table.check(name, values.is_not_null().to_numpy(), must_be)
    found: Reals = values.to_numpy()
    return found


def touch_of(columns: ColumnMap, time: Times, counts: Counts, valid: Flags) -> dict[int, Touch]:
    """Return rows with times (n,), counts and valid (n, cells of all fingertips) by fingertip."""
    found, first, kind = dict[int, Touch](), 0, Zeroed if columns.zeroed else Touch
    for finger, names in columns.cells.items():
        own = slice(first, first := first + len(names))
        temperature = np.zeros_like(counts[:, own])
        found[finger] = kind(time, counts[:, own], temperature, valid[:, own], finger=finger)
    return found


def described(columns: ColumnMap, rate: float) -> Fingertip:
    """Return the fingertip of the counts that a complete map gives; a range becomes counts, of any width.

    Raises:
        ParameterError: if the layout does not fit the cells.
    """
    cells = len(next(iter(columns.cells.values())))
    layout = columns.layout or usual_layout(cells)
    if columns.layout is not None and Fingertip(layout, 1.0).cells != cells:
        must_be = f"of {cells} cells, as many as the counts have"
        raise ParameterError("Trace", "layout", layout_text(layout), must_be)
    resolution, limits = columns.resolution or 1.0, None
    if columns.range is not None:
        middle = np.rint(np.mean(columns.offset or (0,)))
        low, high = np.clip(np.rint(np.array(columns.range) / resolution), -_FAR, _FAR) - middle
        limits = int(low), int(high)
    return Fingertip(layout, rate, columns.unit, resolution, limits)


def resolution_of(values: Reals, *, offset: bool) -> float:
    """Return the step of readings, 1, 2, 2.5 or 5 times a power of ten.

    It is the largest of which all readings are multiples or, if 16 bits do not suffice for it, the smallest
    with which they fit.

    Args:
        values: (n, cells) readings; NaN is missing.
        offset: Each cell may have an offset; False for readings relative to the unloaded fingertip.

    >>> resolution_of(np.array([[101.32], [99.5]]), offset=True)
    0.02
    """
    lowest, highest = np.nanmin(values, axis=0), np.nanmax(values, axis=0)  # (cells,)
    largest, span = float(np.nanmax(np.abs(values))), float(np.max(highest / 2 - lowest / 2))
    plain = _at_least(largest / COUNT_LIMIT)
    centred = _at_least(max(span / (COUNT_LIMIT - 1), largest * _PRECISION))
    fits = min(plain, centred) if offset else plain
    coarse = (step for step in reversed(_STEPS) if step <= max(1.0, plain))
    found = next((step for step in coarse if step < fits or _is_multiple(values, step)), 0.0)
    if found >= fits:
        return found
    return centred if offset and centred < plain / 2 else plain


def offsets(values: Reals, resolution: float) -> Reals:
    """Return the offset of each cell (cells,) in counts: 0, if the readings (n, cells) fit without."""
    lowest, highest = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    middle: Reals = np.rint((highest / 2 + lowest / 2) / resolution)
    fits = max(np.max(highest), -np.min(lowest)) / resolution <= COUNT_LIMIT + 0.5
    return np.zeros_like(middle) if fits else middle


def _at_least(step: float) -> float:
    return next(each for each in _STEPS if each >= step * (1 - 1e-9))


def _is_multiple(values: Reals, step: float) -> bool:
    """Return True if all readings are multiples of a step; NaN is missing."""
    parts = (values[:1000] / step, values / step)  # most other steps fail early
    limit = min(_TOLERANCE, _FLOAT32 * np.nanmax(np.abs(values)) / step)
    return not any(np.any(np.abs(part - np.rint(part)) > limit) for part in parts)


def _is_zeroed(readings: Reals) -> bool:
    """Return True if readings (n, cells) are relative to the unloaded fingertip.

    Some are negative, and most cells come near 0; one reading decides nothing.
    """
    low, high = _quantiles(readings, 0.01), _quantiles(readings, 0.99)  # (cells,)
    near = 0.05 * (high - low)
    return bool(np.any(low < 0) and np.mean((low - near <= 0) & (high + near >= 0)) > 0.5)


def _quantiles(readings: Reals, share: float) -> Reals:
    """Return a quantile of each cell (cells,); it is a reading, so few readings have none in between."""
    some = readings[:: len(readings) // _SAMPLE + 1]
    found: Reals = np.nanquantile(some, share, axis=0, method="nearest")
    return found


def _sentinels(readings: Reals) -> tuple[float, ...]:
    """Return the usual values for no reading that lie far from the other readings of their cell."""
    found = set[float]()
    for cell in readings.T:
        values, rows = np.unique(cell[~np.isnan(cell)], return_counts=True)
        usual = np.isin(values, _SENTINELS) & (2 * rows < rows.sum())
        others = values[~usual]
        if others.size:
            far = 2 * (others[-1] - others[0]) + 10
            distant = (values < others[0] - far) | (values > others[-1] + far)
            found.update(values[usual & distant & (rows < rows[~usual].sum())].tolist())
    return tuple(sorted(found))


def doubts_at_rest(time: Times, readings: Reals) -> list[str]:
    """Return the doubt that a fingertip is loaded in the first second of its readings (n, cells)."""
    start = readings[time <= time[0] + s]
    halves = start[: len(start) // 2 + 1], start[len(start) // 2 :]
    if len(readings) > len(start) and not any(np.isnan(half).all(axis=0).any() for half in halves):
        span = _quantiles(readings, 0.99) - _quantiles(readings, 0.01)
        first, second = (_quantiles(half, 0.5) for half in halves)
        if np.any(np.abs(second - first) > _MOVES * span):
            return ["the readings change in the first second: the baseline needs an unloaded start"]
    return []

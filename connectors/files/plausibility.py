"""Checks of a recording against physics: readings that are none, the unloaded start, the unit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from connectors.files.column_map import PRESSURES, ColumnMap, is_air
from connectors.files.raw_table import RawTable
from operators.batch import Reals, Times, s

EXPORTED: Final = "observation.state"  # zeroed counts in the LeRobot export of slipflow
GAP: Final = 5.0  # mean intervals; a longer interval is a gap
MAX_SPEED: Final = 1.0  # m/s; a higher speed in contact is implausible

_SENTINELS: Final = (
    -99.0,
    -999.0,
    -9999.0,
    -99999.0,
    9999.0,
    99999.0,
    -1.0,
    32767.0,
    -32768.0,
    65535.0,
    4294967295.0,
    1e10,
)
_FAR: Final = 20.0  # spans of the other readings; a reading farther away is an outlier
_OUTLIERS: Final = 0.001  # largest share of a cell's readings
_ENOUGH: Final = 20  # rows
_MOVES: Final = 0.25  # of the range of a cell, in the first second
_SAMPLE: Final = 10_000  # rows for quantiles
_RARE: Final = 0.02  # share of the intervals


@dataclass(frozen=True)
class Plausible:
    """Readings after the checks."""

    readings: Reals  # (n, cells); NaN: missing
    missing: tuple[float, ...]  # readings that mean that there is none
    zeroed: bool  # they are relative to the unloaded fingertip
    notes: tuple[str, ...]  # conclusions
    warnings: tuple[str, ...]  # doubts


def plausible(
    readings: Reals, names: Sequence[str], time: Times, table: RawTable, columns: ColumnMap
) -> Plausible:
    """Check readings (n, cells) of the columns `names`; readings that mean none become missing."""
    notes, warnings = list[str](), list[str]()
    readings = readings.copy()
    missing = columns.missing
    if missing is None:
        missing = _sentinels(readings)
        for value in missing:
            row, cell = np.argwhere(readings == value)[0]
            many = int((readings == value).sum())
            where = f"{table.place_of(int(row))}, column {names[cell]}"
            text = f"{where} is {value:g}, far from all others: taken as missing ({many} in all"
            warnings.append(f"{text}; missing= keeps it)")
    readings[np.isin(readings, missing)] = np.nan
    warnings += _outliers(readings, names, table)
    zeroed = columns.zeroed
    if zeroed is None:
        zeroed = names[0].startswith(EXPORTED) or is_zeroed(readings)
        notes += ["readings relative to the unloaded fingertip"] if zeroed else []
    start = readings[time <= time[0] + s]
    warnings += _doubts_at_rest(start, readings, columns.unit, zeroed=zeroed)
    return Plausible(readings, missing, zeroed, tuple(notes), tuple(warnings))


def is_zeroed(readings: Reals) -> bool:
    """Return True if readings (n, cells) are relative to the unloaded fingertip.

    Some are negative, and most cells come near 0; one reading decides nothing.
    """
    low, high = _quantiles(readings, 0.01), _quantiles(readings, 0.99)  # (cells,)
    near = 0.05 * (high - low)
    return bool(np.any(low < 0) and np.mean((low - near <= 0) & (high + near >= 0)) > 0.5)


def motion_doubts(speeds: Reals) -> list[str]:
    """Return a doubt about speeds (n,) of the arm, m/s."""
    fastest = float(speeds.max(initial=0.0))
    text = f"the arm moves at up to {fastest:.3g} m/s: is its speed in another unit?"
    return [text] if fastest > MAX_SPEED else []


def gap_doubts(time: Times, rate: float | None) -> list[str]:
    """Return a doubt about pauses in times (n,) of rows with a rate."""
    stamps = np.unique(time)  # rows may share times
    steps = np.diff(stamps)
    if not steps.size or rate is None:
        return []
    gaps = np.flatnonzero(steps > GAP * max(s / rate, float(np.median(steps))))
    if not 0 < gaps.size <= max(5, _RARE * steps.size):
        return []
    longest = int(gaps[np.argmax(steps[gaps])])
    many = "a gap" if len(gaps) == 1 else f"{len(gaps)} gaps, the longest"
    after = (stamps[longest] - stamps[0]) / s
    return [f"the time has {many} of {steps[longest] / s:.3g} s after {after:.4g} s"]


def _quantiles(readings: Reals, share: float) -> Reals:
    """Return a quantile of each cell (cells,); it is a reading, so few readings have none in between."""
    some = readings[:: len(readings) // _SAMPLE + 1]
    found: Reals = np.nanquantile(some, share, axis=0, method="nearest")
    return found


def _sentinels(readings: Reals) -> tuple[float, ...]:
    """Return the usual values for no reading that lie far from the other readings of their cell."""
    found = set[float]()
    for cell in readings.T:
        present = [value for value in _SENTINELS if np.any(cell == value)]
        for value in present:
            others = cell[~np.isin(cell, present) & ~np.isnan(cell)]
            if others.size > np.count_nonzero(cell == value):
                low, high = others.min(), others.max()
                if not low - 2 * (high - low) - 10 <= value <= high + 2 * (high - low) + 10:
                    found.add(value)
    return tuple(sorted(found))


def _outliers(readings: Reals, names: Sequence[str], table: RawTable) -> list[str]:
    """Return a doubt about single readings far from all others of their cell."""
    if len(readings) < _ENOUGH:
        return []
    share = max(_OUTLIERS, 1.5 / len(readings))  # without the lowest and the highest
    low, high = _quantiles(readings, share), _quantiles(readings, 1 - share)
    span = np.maximum(high - low, 1e-9 * np.maximum(np.abs(high), np.abs(low)))
    with np.errstate(invalid="ignore"):
        far = (readings < low - _FAR * span) | (readings > high + _FAR * span)
    if not far.any():
        return []
    row, cell = np.argwhere(far)[0]
    where = f"{table.place_of(int(row))}, column {names[cell]}"
    text = f"{where} is {readings[row, cell]:g}, far from the others ({int(far.sum())} such)"
    return [f"{text}: is it a fault? missing=VALUE leaves it out"]


def _doubts_at_rest(start: Reals, readings: Reals, unit: str, *, zeroed: bool) -> list[str]:
    """Return doubts about the readings of the first second."""
    found = list[str]()
    level = np.nanmedian(start) if np.isfinite(start).any() else np.nan
    likely = [each for each in PRESSURES if is_air(float(level), each)]
    if unit in PRESSURES and not zeroed and likely and unit not in likely:
        air = " or ".join(likely)
        found.append(f"{level:g} {unit} at the start would be air pressure in {air}: is the unit right?")
    span = _quantiles(readings, 0.99) - _quantiles(readings, 0.01)
    halves = start[: len(start) // 2 + 1], start[len(start) // 2 :]
    if len(readings) > len(start) and not any(np.isnan(half).all(axis=0).any() for half in halves):
        first, second = (_quantiles(half, 0.5) for half in halves)
        if np.any(np.abs(second - first) > _MOVES * span):
            found.append("the readings change in the first second: the baseline needs an unloaded start")
    return found

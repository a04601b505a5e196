"""Interpretation of a table: each stage adds its conclusions, and all problems become one error."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import LABEL, LABELS, MOTIONS, UNITS, ColumnMap
from connectors.files.number_format import MISSING, with_decimal
from connectors.files.raw_table import RawTable
from connectors.files.readings import described, doubts_at_rest, readings_of, reals_of, touch_of
from connectors.files.roles import SLIP_WORD, completed, label_value, label_values
from connectors.files.time_axis import time_axis
from operators.batch import EVERY, SLIP, STATIC, UNKNOWN, Codes, Flags, Motion, Reals, Touch, s
from operators.errors import InputError
from operators.fingertip import RATE_TOLERANCE, Fingertip, rows_per_second

_MAX_SPEED: Final = 1.0  # m/s; a higher speed in contact is implausible
_WORDS_SHOWN: Final = 5


@dataclass(frozen=True)
class Part:
    """Rows of a recording with a clock that never goes back, and all that was concluded."""

    file: str  # name, also of a table in memory
    sha256: str  # of the file, hex; empty for a table in memory
    columns: ColumnMap  # complete, without absent quantities
    unused: tuple[str, ...]  # columns of the table that are not in the map
    stated: frozenset[str]  # quantities that the user mapped; others were recognised by their names
    fingertip: Fingertip | None  # None: the rate is unknown
    notes: tuple[str, ...]  # conclusions on how the data is read
    warnings: tuple[str, ...]  # doubts about implausible values
    fingertips: Mapping[int, Touch]  # rows by fingertip, Touch or Zeroed
    motion: Motion  # of the arm; no rows if there is none
    labels: Codes  # (n,) 1 slip, 0 static, -1 unknown

    @property
    def touch(self) -> Touch:
        """Rows of the first fingertip."""
        return next(iter(self.fingertips.values()))

    @property
    def seconds(self) -> float:
        """Time from the first row to the last, s."""
        return int(self.touch.time[-1] - self.touch.time[0]) / s

    @property
    def offset(self) -> Reals:
        """Counts to add to each cell of all fingertips; a reading is (count + offset) x resolution."""
        return np.resize(self.columns.offset or (0,), len(self.columns.cell_names))

    @property
    def resolution(self) -> float:
        """Units per count."""
        return self.columns.resolution or 1.0

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest reading, in the unit of the counts."""
        touch = self.fingertips.values()
        counts, valid = (np.hstack([getattr(each, name) for each in touch]) for name in ("counts", "valid"))
        readings = (counts + self.offset)[valid]
        return float(readings.min() * self.resolution), float(readings.max() * self.resolution)


def interpret(table: RawTable, stated: ColumnMap, *, split: bool = False) -> list[Part]:
    """Interpret a table by what the user states; with `split`, a clock that starts again begins another part.

    Raises:
        InputError: that lists all problems, with a map that solves them.
        ParameterError: if the layout or the range does not fit the cells.
    """
    if not len(table) or not table.columns:
        raise InputError(table.file, "has no columns of numbers or texts" if len(table) else "has no rows")
    columns = with_decimal(table, completed(table, stated))
    columns, time, ends = time_axis(table, replace(columns, separator=table.separator), split=split)
    columns, counts, valid = readings_of(table, columns)
    velocity, labels = _velocity(table, columns), _labels(table, columns)
    table.stop()
    fingertip, parts = described(columns, columns.rate) if columns.rate else None, list[Part]()
    used = {name for names in columns.columns.values() for name in names}
    unused = tuple(name for name in (*table.columns, *table.left_out) if name not in used)
    moving: Flags = np.all(np.isfinite(velocity), axis=1)
    for start, stop in ends:
        rows = slice(start, stop)
        touch = touch_of(columns, time[rows], counts[rows], valid[rows])
        still = np.full((stop - start, 6), np.nan)
        motion = Motion(time[rows], time[rows], velocity[rows], still, finger=EVERY)[moving[rows]]
        if not valid[rows].any():
            where = f"{table.file}, {table.place} {table.numbers[start]}"
            raise InputError(where, "begins a part without readings: delete the part")
        for each in touch.values():  # lost readings leave the rate of the others as it is
            read = each[np.flatnonzero(each.valid.any(axis=1))]
            rates = [rows_per_second(time) or 0.0 for time in (read.time, each.time)]  # Hz
            if rates[0] < (1 - RATE_TOLERANCE) * rates[1] and len(read) < 7 / 8 * len(each):
                reason = f"only {len(read)} of {len(each)} rows have readings, as in merged streams"
                remedy = "leave the others out, and join the velocity by time (docs/how-to/import.md)"
                raise InputError(table.file, f"{reason}: {remedy}")
        doubts = [text for row, text in table.warnings if row is None or start <= row < stop]
        warnings = [*doubts, *doubts_at_rest(time[rows], np.where(valid[rows], counts[rows], np.nan))]
        if (fastest := speeds_of(motion).max(initial=0.0)) > _MAX_SPEED:
            warnings.insert(0, f"the arm moves at up to {fastest:.3g} m/s: is its speed in another unit?")
        if bad := int(np.count_nonzero(~np.all(valid[rows], axis=1))):
            many = int(np.count_nonzero(~valid[rows]))
            warnings.append(f"missing readings: {many}, in {bad} of {stop - start} rows")
        found = table.file, table.sha256, columns, unused, frozenset(stated.columns), fingertip
        parts.append(Part(*found, tuple(table.notes), tuple(warnings), touch, motion, labels[rows]))
    return parts


def speeds_of(motion: Motion) -> Reals:
    """Return the speed of the arm in each row, (n,) m/s."""
    speeds: Reals = np.linalg.norm(motion.velocity[:, :3], axis=1)
    return speeds


def _velocity(table: RawTable, columns: ColumnMap) -> Reals:
    """Return the velocity of the arm (n, 6), m/s and rad/s; NaN: unknown."""
    for key in MOTIONS:
        if names := columns.columns.get(key):
            given = np.column_stack([reals_of(table, name, columns) for name in names])
            given[:, :3] *= UNITS[key][columns.units[key]]
            return np.pad(given, ((0, 0), (0, 6 - len(names))))
    return np.full((len(table), 6), np.nan)


def _labels(table: RawTable, columns: ColumnMap) -> Codes:
    """Return the labels of the rows (n,); other values than the stated or usual ones are a problem."""
    if LABEL not in columns.columns:
        return np.full(len(table), LABELS[columns.labelled or "unknown"], np.int8)
    [name] = columns.columns[LABEL]
    texts = table.columns[name].cast(pl.String, strict=False).fill_null("")
    known, codes = label_values(columns.labels), dict[str, int | None]()
    for text in texts.unique(maintain_order=True):
        value = label_value(text)
        other = UNKNOWN if value in MISSING else STATIC if set(columns.labels) == {"slip"} else None
        codes[text] = LABELS[known[value]] if value in known else other
    found = texts.replace_strict(codes, return_dtype=pl.Int8)
    if words := [text for text, code in codes.items() if code is None]:
        listed = ", ".join(map(repr, words[:_WORDS_SHOWN])) + ", ..." * (len(words) > _WORDS_SHOWN)
        place = table.place_of(int(found.is_null().arg_true()[0]), name)
        text = f"has {listed}, neither slip nor static by"
        if columns.labels:
            more = words if len(words) <= _WORDS_SHOWN else ["WORD"]
            fix = f"labels.unknown={','.join((*columns.labels.get('unknown', ()), *more))}"
            table.add_problem(f"{text} the map; state {fix}", place, fix=fix)
        else:
            usual = [text for text in codes if known.get(label_value(text)) == "slip"]
            fix = f"labels.slip={','.join(filter(SLIP_WORD.search, usual)) or 'WORD'}"
            table.add_problem(f"{text} usual words; state labels.slip=... (others: static)", place, fix=fix)
    given = [(label, [text for text in codes if text and codes[text] == LABELS[label]]) for label in LABELS]
    meanings = "; ".join(f"{label}: {', '.join(words):.100}" for label, words in given if words)
    table.notes += [meanings] if meanings else []
    stated = {label_value(value) for values in columns.labels.values() for value in values}
    if absent := sorted(stated - set(map(label_value, codes))):
        has = ", ".join(f"{text!r} ({many})" for text, many in texts.value_counts(sort=True).rows())
        which = " or ".join(map(repr, absent))
        table.warn(f"no row has the label {which}; the column has {has:.200}")
    if {*codes.values()} == {SLIP, UNKNOWN}:
        table.warn("no row is static: an empty label means unknown")
    labels: Codes = found.fill_null(UNKNOWN).to_numpy()
    return labels

"""Interpretation of a table: each stage adds its conclusions, and all problems become one error."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import polars as pl

from connectors.files.column_map import DATE, LABEL, LABELS, MOTIONS, TIME, ColumnMap
from connectors.files.number_format import MISSING, NumberFormat, number_format
from connectors.files.raw_table import Problems, RawTable
from connectors.files.readings import described, readings_of, reals_of
from connectors.files.roles import completed, label_value, label_values
from connectors.files.time_axis import gap_doubts, time_axis
from operators.batch import EVERY, STATIC, UNKNOWN, Codes, Flags, Motion, Reals, Touch
from operators.fingertip import Fingertip

_MAX_SPEED: Final = 1.0  # m/s; a higher speed in contact is implausible
_WORDS_SHOWN: Final = 5


@dataclass(frozen=True)
class Part:
    """Rows of a recording with a clock that never goes back, and all that was concluded."""

    file: str  # name, also of a table in memory
    sha256: str  # of the file, hex; empty for a table in memory
    columns: ColumnMap  # complete, without absent quantities
    stated: frozenset[str]  # quantities that the user mapped; others were recognised by their names
    rate: float | None  # rows per second; None: unknown
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
    def offset(self) -> Reals:
        """Counts to add to those of each cell (cells,); a reading is (count + offset) x resolution."""
        return np.resize(self.columns.offset or (0,), self.touch.cells)

    @property
    def resolution(self) -> float:
        """Units per count."""
        return self.columns.resolution or 1.0

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest reading, in the unit of the counts."""
        touch = self.fingertips.values()
        counts, valid = (np.hstack([getattr(each, name) for each in touch]) for name in ("counts", "valid"))
        readings = (counts + np.array(self.columns.offset or 0))[valid]
        return float(readings.min() * self.resolution), float(readings.max() * self.resolution)

    @property
    def missing(self) -> int:
        """Number of missing readings."""
        return sum(int(np.count_nonzero(~each.valid)) for each in self.fingertips.values())

    @property
    def speeds(self) -> Reals:
        """Speed of the arm in each row of motion, (n,) m/s."""
        speeds: Reals = np.linalg.norm(self.motion.velocity[:, :3], axis=1)
        return speeds


def interpret(table: RawTable, stated: ColumnMap, *, split: bool = False) -> list[Part]:
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
    readings = readings_of(table, columns, numbers, axis.time, problems)
    columns, velocity = readings.columns, _velocity(table, columns, numbers, problems)
    labels = _labels(table, columns, problems)
    problems.stop()
    fingertip = described(columns) if columns.rate else None
    parts = list[Part]()
    for part in (slice(*ends) for ends in axis.parts):
        time, touch, first = axis.time[part], dict[int, Touch](), 0
        for finger, names in columns.cells.items():
            cells = slice(first, first := first + len(names))
            counts, valid = readings.counts[part, cells], readings.valid[part, cells]
            touch[finger] = columns.kind(time, counts, np.zeros_like(counts), valid, finger=finger)
        moving: Flags = np.all(np.isfinite(velocity[part]), axis=1)
        unknown = np.full((len(time), 6), np.nan)
        motion = Motion(time, time, velocity[part], unknown, finger=EVERY)[moving]
        doubts = [*axis.warnings, *readings.warnings]
        found = Part(
            table.file,
            table.sha256,
            columns,
            frozenset(stated.columns),
            axis.rate,
            fingertip,
            (*table.notes, *notes, *axis.notes, *readings.notes),
            (),
            touch,
            motion,
            labels[part],
        )
        if (fastest := float(found.speeds.max(initial=0.0))) > _MAX_SPEED:
            doubts.insert(0, f"the arm moves at up to {fastest:.3g} m/s: is its speed in another unit?")
        if found.missing:
            bad: Flags = np.any(~readings.valid[part], axis=1)
            doubts.append(f"missing readings: {found.missing}, in {np.count_nonzero(bad)} of {len(bad)} rows")
        parts.append(replace(found, warnings=(*doubts, *gap_doubts(time, axis.rate))))
    return parts


def _velocity(table: RawTable, columns: ColumnMap, numbers: NumberFormat, problems: Problems) -> Reals:
    """Return the velocity of the arm (n, 6), m/s and rad/s; NaN: unknown."""
    for key in MOTIONS:
        if names := columns.columns.get(key):
            given = np.column_stack([reals_of(table, name, numbers, problems) for name in names])
            given[:, :3] *= columns.scale(key)
            return np.pad(given, ((0, 0), (0, 6 - len(names))))
    return np.full((len(table), 6), np.nan)


def _labels(table: RawTable, columns: ColumnMap, problems: Problems) -> Codes:
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
        text = f"has {listed}, neither slip nor static by usual words; state labels.slip=... (others: static)"
        place = f"{table.place_of(int(found.is_null().arg_true()[0]))}, column {name}"
        problems.add(text, place, fix=None if columns.labels else f"labels.slip={words[0]}")
    labels: Codes = found.fill_null(UNKNOWN).to_numpy()
    return labels

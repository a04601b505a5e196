"""Recorded trace of one fingertip, from a file of any format."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar, cast

import numpy as np

from connectors.files.column_map import (
    COUNTS,
    JOINT,
    LABEL,
    MOTIONS,
    SIZES,
    SPEED,
    TIME,
    UNITS,
    VELOCITY,
    ColumnMap,
)
from connectors.files.formats import read_table
from connectors.files.pad import Pad
from connectors.files.resolution import COUNT_LIMIT, Steps, common, needed, offsets
from operators.batch import (
    EVERY,
    UNKNOWN,
    Batch,
    Codes,
    Counts,
    Flags,
    Motion,
    Reals,
    Times,
    Touch,
    Zeroed,
    s,
)
from operators.checks import check_between
from operators.errors import InputError, ParameterError
from operators.fingertip import Fingertip, measured
from operators.ports import Description, Json

if TYPE_CHECKING:
    from connectors.files.trace_table import TraceTable

SomeBatch = TypeVar("SomeBatch", bound=Batch)

SLOWEST: Final = 5.0  # Hz; a rate outside these limits is implausible
FASTEST: Final = 5000.0  # Hz
MAX_SPEED: Final = 1.0  # m/s; a higher speed in contact is implausible
GAP: Final = 5.0  # median intervals; a longer interval is a gap

_INT16: Final = np.iinfo(np.int16)
_DEFAULT: Final = ColumnMap()
_UNKNOWN_PAD: Final = Pad()


class Trace:
    """`Recording` of one fingertip, and of the motion if the file has it, loaded completely and checked.

    Decimal times are converted exactly, then rounded to the nearest ns. Other columns are ignored.
    Readings become whole counts of a `resolution`; if they do not fit in 16 bits, each cell has an offset. A
    missing reading is an invalid cell. Temperatures are 0 (unknown) and the arm's pose is NaN. A speed
    becomes a velocity along x of the base frame. A row without a velocity adds no row of motion.

    Args:
        source: The file, or a table that was read from one.
        columns: Map of the columns; unmapped quantities are recognised by common column names.
        finger: Number of the fingertip.
        zeroed: Readings are relative to the unloaded fingertip; default: True if one is negative.
        rate: Rows per second (Hz) of a file without a time column; its times start at 0.
        group: Surface or object of the recording.
        pad: Layout and range of the fingertip (default: measured layout, unknown range).

    Attributes:
        columns: The completed map, without absent quantities.
        sha256: Checksum of the file, hex.
        steps: Resolutions that the readings need.
        resolution: Units per count.
        offset: (cells,) counts; a reading is (count + offset) x resolution.
        missing: Number of missing readings.
        touch: The whole trace, Touch or Zeroed.
        motion: Motion of the arm; no rows if the file has none.
        labels: (n,) 1 slip, 0 static, -1 unknown.

    Raises:
        InputError: if the file cannot be read or has an invalid value; it names row and column.
        ParameterError: on an invalid rate or fingertip.
    """

    columns: ColumnMap
    steps: Steps
    touch: Touch
    motion: Motion
    labels: Codes

    def __init__(
        self,
        source: "str | Path | TraceTable",
        columns: ColumnMap = _DEFAULT,
        *,
        finger: int = 0,
        zeroed: bool | None = None,
        rate: float | None = None,
        group: str | None = None,
        pad: Pad = _UNKNOWN_PAD,
    ) -> None:
        if rate is not None and not 0 < rate <= s:
            raise ParameterError("Trace", "rate", rate, f"above 0 and at most {s:.0e} Hz")
        check_between("Trace", "finger", finger, 0, _INT16.max)
        table = read_table(source) if isinstance(source, str | Path) else source
        self._file, self.sha256, self.group, self._about = table.file, table.sha256, group, table.about
        if table.motion is None:
            self.columns = moves = columns.completed(table.header, timed=rate is None)
        else:
            here = [name for name in SIZES if name not in MOTIONS]
            self.columns = columns.completed(table.header, timed=rate is None, only=here)
            moves = columns.completed(table.motion.header, only=(TIME, *MOTIONS))
        found = self.columns.columns
        if TIME in found and columns.lenient:
            table = table.timed(found[TIME][0], self.columns.units[TIME])
        self.notes = table.notes
        if TIME in found:
            times = table.times(found[TIME][0], self.columns.units[TIME])
        else:
            times = np.rint(np.arange(len(table)) * (s / cast("float", rate))).astype(np.int64)
        readings = self._readings(table)
        if zeroed is None:
            zeroed = bool(np.any(readings < 0))
        counts, valid = self._counts(table, readings, zeroed=zeroed)
        kind = Zeroed if zeroed else Touch
        self.touch = kind(times, counts, np.zeros_like(counts), valid, finger=finger)
        self._fingertip = self._described(pad)
        self.missing = int(np.count_nonzero(~valid))
        self.motion = _motion(table.motion or table, moves, None if table.motion else times)
        if table.motion:  # described like the columns of this table
            moved = {name: moves.columns[name] for name in MOTIONS if name in moves.columns}
            units = {name: moves.units[name] for name in moved}
            self.columns = replace(
                self.columns, columns={**found, **moved}, units={**self.columns.units, **units}
            )
        if LABEL in found:
            self.labels = table.codes(found[LABEL][0], *self.columns.label_codes, UNKNOWN)
        else:
            self.labels = np.full(len(times), UNKNOWN, np.int8)

    def _readings(self, table: "TraceTable") -> Reals:
        """Return the readings of the cells, (n, cells) in the unit of the counts; NaN: missing."""
        names, lenient = self.columns.columns[COUNTS], self.columns.lenient
        whole = self.columns.cell_units[0] == "count" and self.columns.resolution is None
        readings = np.empty((len(table), len(names)))
        for cell, name in enumerate(names):
            values = table.reals(name, lenient=lenient)
            if whole:
                fix = "a whole number (or state a unit, as counts=kPa, or a resolution)"
                table.check(name, np.isnan(values) | (values == np.rint(values)), fix)
            if np.isnan(values).all():
                raise InputError(table.where, f"column {name} has no readings")
            readings[:, cell] = values
        factor = self.columns.scale(COUNTS)
        return readings if factor == 1 else readings * factor

    def _counts(self, table: "TraceTable", readings: Reals, *, zeroed: bool) -> tuple[Counts, Flags]:
        """Return the counts (n, cells) of the readings, and which are valid."""
        self.steps = needed(readings)
        self.resolution = self.columns.resolution or common([self.steps], offset=not zeroed)
        self.offset = np.zeros(readings.shape[1]) if zeroed else offsets(readings, self.resolution)
        counts = np.rint(readings / self.resolution - self.offset)
        valid: Flags = ~np.isnan(readings)
        for cell, name in enumerate(self.columns.columns[COUNTS]):
            ends = (np.array([-1, 1]) * COUNT_LIMIT + self.offset[cell]) * self.resolution
            limits = f"from {ends[0]:g} to {ends[1]:g} at a resolution of {self.resolution:g}"
            table.check(name, ~(np.abs(counts[:, cell]) > COUNT_LIMIT), limits)
        return np.where(valid, counts, 0).astype(np.int16), valid

    def _described(self, pad: Pad) -> Fingertip:
        """Return the fingertip of the counts; a range in the unit of the file becomes counts.

        Raises:
            ParameterError: if layout or range do not fit the cells.
        """
        found, limits = measured(self.touch), None
        pad.check_cells("Trace", found.cells)
        if pad.range is not None:
            factor, offset = self.columns.scale(COUNTS) / self.resolution, self.offset.mean()
            ends = np.clip(np.rint(np.array(pad.range) * factor - offset), -COUNT_LIMIT, COUNT_LIMIT)
            limits = int(ends[0]), int(ends[1])
        layout, unit = pad.layout or found.layout, self.columns.cell_units[1]
        return replace(found, layout=layout, unit=unit, resolution=self.resolution, range=limits)

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest reading, in the unit of the counts."""
        readings = (self.touch.counts + self.offset)[self.touch.valid]
        return float(readings.min() * self.resolution), float(readings.max() * self.resolution)

    @property
    def name(self) -> str:
        """Path of the file."""
        return self._file

    @property
    def kind(self) -> type[Touch]:
        """Type of the touch stream: Touch or Zeroed."""
        return type(self.touch)

    @cached_property
    def rate(self) -> float | None:
        """Median rate of the rows (Hz); None if all have the same time."""
        interval = float(np.median(np.diff(self.touch.time))) if len(self.touch) > 1 else 0.0
        return s / interval if interval else None

    @property
    def speeds(self) -> Reals:
        """Speed of the arm in each row of motion, (n,) m/s."""
        speeds: Reals = np.linalg.norm(self.motion.velocity[:, :3], axis=1)
        return speeds

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about implausible values, such as a wrong unit, one line each."""
        lines = list[str]()
        fastest, rate = float(self.speeds.max(initial=0.0)), self.rate
        if fastest > MAX_SPEED:
            units = " or ".join(self._slower_units(fastest)) or "another unit"
            lines.append(f"the arm moves at up to {fastest:.3g} m/s: is its speed in {units}?")
        if rate is not None and not SLOWEST <= rate <= FASTEST:
            lines.append(f"the rate is {rate:.4g} Hz: is the time in another unit?")
        if self.missing:
            rows = int(np.count_nonzero(~self.touch.valid.all(axis=1)))
            lines.append(f"missing readings: {self.missing}, in {rows} of {len(self.touch)} rows")
        intervals = np.diff(self.touch.time) * ((rate or 0.0) / s)  # (n - 1,) median intervals
        if (gaps := np.flatnonzero(intervals > GAP)).size:
            longest = int(gaps[np.argmax(intervals[gaps])])
            span, at = (self.touch.time[longest + 1] - self.touch.time[longest]) / s, self.touch.time[longest]
            many = "a gap" if len(gaps) == 1 else f"{len(gaps)} gaps, the longest"
            lines.append(f"the time has {many} of {span:.3g} s after {(at - self.touch.time[0]) / s:.4g} s")
        return tuple(lines)

    def _slower_units(self, fastest: float) -> list[str]:
        """Return the units in which the file's highest speed (m/s) would be plausible, with that speed."""
        given = [name for name in (VELOCITY, SPEED) if name in self.columns.units]
        speeds = {
            unit: fastest * factor / self.columns.scale(name)
            for name in given
            for unit, factor in UNITS[name].items()
        }
        return [f"{unit} ({speed:.3g} m/s)" for unit, speed in speeds.items() if speed <= MAX_SPEED]

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip: cells, rate, unit and resolution of the file, layout and range as given."""
        return self._fingertip if issubclass(kind, Touch) else None

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """Return the fingers with a stream of a type; EVERY for the arm's motion."""
        streams = [stream for stream in (self.touch, self.motion) if len(stream)]
        return tuple(stream.finger for stream in streams if isinstance(stream, kind))

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """Yield a stream in batches of at most `rows`.

        Raises:
            InputError: if there is no such stream.
        """
        if finger not in self.fingers(kind):
            raise InputError(self.name, f"has no {kind.__name__} stream of finger {finger}")
        stream = cast("SomeBatch", self.touch if isinstance(self.touch, kind) else self.motion)
        return (stream[start : start + rows] for start in range(0, len(stream), rows))

    def describe(self) -> Description:
        """Return the file's name, sha256 and number of rows, and the map of its columns."""
        columns: dict[str, Json] = {name: list(names) for name, names in self.columns.columns.items()}
        about: dict[str, Json] = {
            "trace": Path(self._file).name,
            "sha256": self.sha256,
            "rows": len(self.touch),
            "zeroed": self.kind is Zeroed,
            "columns": columns,
            "units": dict(self.columns.units),
        }
        about |= self._about
        if self.group is not None:
            about["group"] = self.group
        if JOINT in columns:
            about["lever"] = self.columns.lever
        if LABEL in columns and self.columns.labels:
            about["labels"] = {name: list(values) for name, values in self.columns.labels.items()}
        if self.offset.any():
            about["offset"] = [int(each) for each in self.offset]
        return about


def _motion(table: "TraceTable", columns: ColumnMap, times: Times | None) -> Motion:
    """Return the rows with a velocity.

    Args:
        table: Table with the motion.
        columns: Its completed map.
        times: Times of its rows; None: they are in the table.
    """
    if times is None:
        times = table.times(columns.columns[TIME][0], columns.units[TIME])
    velocity: Reals = np.full((len(times), 6), np.nan)
    for name in MOTIONS:
        if names := columns.columns.get(name):
            given = [table.reals(each, lenient=columns.lenient) for each in names]
            velocity = np.pad(np.column_stack(given), ((0, 0), (0, 6 - len(given))))
            velocity[:, :3] *= columns.scale(name)
            if name == JOINT:
                velocity = np.abs(velocity) * (columns.lever or 0.0)
    moving: Flags = np.all(np.isfinite(velocity), axis=1)
    unknown = np.full((len(times), 6), np.nan)
    return Motion(times, times, velocity, unknown, finger=EVERY)[moving]

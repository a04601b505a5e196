"""Recorded trace of one fingertip, from a file or a DataFrame."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import numpy as np

from connectors.files.column_map import (
    COUNTS,
    LABEL,
    MOTIONS,
    TIME,
    ColumnMap,
    layout_text,
)
from connectors.files.resolution import COUNT_LIMIT, is_multiple, offsets, resolution_of
from connectors.files.roles import completed
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
from operators.errors import InputError, ParameterError
from operators.fingertip import RATE_TOLERANCE, Fingertip, measured
from operators.ports import Description, Json

if TYPE_CHECKING:
    from connectors.files.trace_table import TraceTable

SomeBatch = TypeVar("SomeBatch", bound=Batch)

SLOWEST: Final = 5.0  # Hz; a rate outside these limits is implausible
FASTEST: Final = 5000.0  # Hz
MAX_SPEED: Final = 1.0  # m/s; a higher speed in contact is implausible
GAP: Final = 5.0  # median intervals; a longer interval is a gap

_DEFAULT: Final = ColumnMap()


class Trace:
    """`Recording` of one fingertip, and of the motion if there is one, loaded completely and checked.

    Decimal times are converted exactly, then rounded to the nearest ns. Other columns are ignored.
    Readings become whole counts of a `resolution`; if they do not fit in 16 bits, each cell has an offset. A
    missing reading is an invalid cell. Temperatures are 0 (unknown) and the arm's pose is NaN. A speed
    becomes a velocity along x of the base frame. A row without a velocity adds no row of motion.

    Args:
        source: A CSV or Parquet file, or a polars or pandas DataFrame, or a dictionary of arrays.
        columns: Map of the columns; unmapped quantities are recognised by common column names.
        name: Name of a DataFrame.
        group: Surface or object of the recording.
        about: Further entries of the description.

    Attributes:
        columns: The completed map, without absent quantities.
        sha256: Checksum of the file, hex; empty for a DataFrame.
        notes: Remarks on how the file was read.
        resolution: Units per count.
        offset: (cells,) counts; a reading is (count + offset) x resolution.
        missing: Number of missing readings.
        touch: The whole trace, Touch or Zeroed.
        motion: Motion of the arm; no rows if there is none.
        labels: (n,) 1 slip, 0 static, -1 unknown.

    Raises:
        InputError: if the file cannot be read, or has an invalid value or another rate; it names row and
            column.
        ParameterError: if the layout or the range does not fit the cells.
    """

    columns: ColumnMap
    touch: Touch
    motion: Motion
    labels: Codes

    def __init__(
        self,
        source: Any,  # noqa: ANN401 - all that pl.DataFrame takes
        columns: ColumnMap = _DEFAULT,
        *,
        name: str = "table",
        group: str | None = None,
        about: Description | None = None,
    ) -> None:
        table, stated = _table(source, name), columns.resolution
        self.name, self.sha256, self.group, self._about = table.file, table.sha256, group, about or {}

        self.columns = columns = completed(columns, table.header)
        found = columns.columns
        if TIME in found:
            times = table.times(found[TIME][0], columns.units[TIME])
        else:
            times = np.rint(np.arange(len(table)) * (s / cast("float", columns.rate))).astype(np.int64)
        self.notes = table.notes
        readings = self._readings(table)
        zeroed = bool(np.any(readings < 0)) if columns.zeroed is None else columns.zeroed
        self.resolution = stated or resolution_of(readings, offset=not zeroed)
        self._rounded = stated is not None and not is_multiple(readings, stated)
        self.offset = np.zeros(readings.shape[1]) if zeroed else offsets(readings, self.resolution)
        counts, valid = self._counts(table, readings)
        kind = Zeroed if zeroed else Touch
        self.touch = kind(times, counts, np.zeros_like(counts), valid, finger=columns.finger)
        self._fingertip = self._described()
        self.missing = int(np.count_nonzero(~valid))
        self.motion = _motion(table, columns, times)
        if LABEL in found:
            self.labels = table.codes(found[LABEL][0], *columns.label_codes, UNKNOWN)
        else:
            self.labels = np.full(len(times), UNKNOWN, np.int8)
        self._check_rate()

    def _readings(self, table: "TraceTable") -> Reals:
        """Return the readings of the cells, (n, cells) in their unit; NaN: missing."""
        names = self.columns.columns[COUNTS]
        whole = self.columns.unit == "count" and self.columns.resolution is None
        readings = np.empty((len(table), len(names)))
        for cell, name in enumerate(names):
            values = table.reals(name)
            if whole:
                fix = "a whole number (or state a unit, as units.counts=kPa, or a resolution)"
                table.check(name, np.isnan(values) | (values == np.rint(values)), fix)
            if np.isnan(values).all():
                raise InputError(table.file, f"column {name} has no readings")
            readings[:, cell] = values
        return readings

    def _counts(self, table: "TraceTable", readings: Reals) -> tuple[Counts, Flags]:
        """Return the counts (n, cells) of the readings, and which are valid."""
        counts = np.rint(readings / self.resolution - self.offset)
        valid: Flags = ~np.isnan(readings)
        for cell, name in enumerate(self.columns.columns[COUNTS]):
            ends = (np.array([-1, 1]) * COUNT_LIMIT + self.offset[cell]) * self.resolution
            limits = f"from {ends[0]:g} to {ends[1]:g} at a resolution of {self.resolution:g}"
            table.check(name, ~(np.abs(counts[:, cell]) > COUNT_LIMIT), limits)
        return np.where(valid, counts, 0).astype(np.int16), valid

    def _described(self) -> Fingertip:
        """Return the fingertip of the counts; a range in the unit of the cells becomes counts."""
        found, limits, layout = measured(self.touch), None, self.columns.layout
        if layout is not None and Fingertip(layout, 1.0).cells != found.cells:
            must_be = f"of {found.cells} cells, as many as the counts have"
            raise ParameterError("Trace", "layout", layout_text(layout), must_be)
        if self.columns.range is not None:
            readings = np.array(self.columns.range) / self.resolution - self.offset.mean()
            ends = np.clip(np.rint(readings), -COUNT_LIMIT, COUNT_LIMIT)
            limits = int(ends[0]), int(ends[1])
        return Fingertip(layout or found.layout, found.rate, self.columns.unit, self.resolution, limits)

    def _check_rate(self) -> None:
        """Require the rate of the map, if it has one."""
        expected, found = self.columns.rate, self.rate
        if expected and found and abs(found - expected) > RATE_TOLERANCE * expected:
            reason = f"has {found:.1f} rows per second, not {expected:g}: is its time in another unit?"
            raise InputError(self.name, reason)

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest reading, in the unit of the counts."""
        readings = (self.touch.counts + self.offset)[self.touch.valid]
        return float(readings.min() * self.resolution), float(readings.max() * self.resolution)

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
            lines.append(f"the arm moves at up to {fastest:.3g} m/s: is its speed in another unit?")
        if rate is not None and not SLOWEST <= rate <= FASTEST:
            lines.append(f"the rate is {rate:.4g} Hz: is the time in another unit?")
        if self.missing:
            rows = int(np.count_nonzero(~self.touch.valid.all(axis=1)))
            lines.append(f"missing readings: {self.missing}, in {rows} of {len(self.touch)} rows")
        if self._rounded:
            lines.append(f"the readings are rounded to steps of {self.resolution:g} {self.columns.unit}")
        intervals = np.diff(self.touch.time) * ((rate or 0.0) / s)  # (n - 1,) median intervals
        if (gaps := np.flatnonzero(intervals > GAP)).size:
            longest = int(gaps[np.argmax(intervals[gaps])])
            span, at = (self.touch.time[longest + 1] - self.touch.time[longest]) / s, self.touch.time[longest]
            many = "a gap" if len(gaps) == 1 else f"{len(gaps)} gaps, the longest"
            lines.append(f"the time has {many} of {span:.3g} s after {(at - self.touch.time[0]) / s:.4g} s")
        return tuple(lines)

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
        """Return the name, sha256 and number of rows of the file, and the map of its columns."""
        columns: dict[str, Json] = {name: list(names) for name, names in self.columns.columns.items()}
        about: dict[str, Json] = {
            "trace": Path(self.name).name,
            "sha256": self.sha256,
            "rows": len(self.touch),
            "zeroed": self.kind is Zeroed,
            "columns": columns,
            "units": dict(self.columns.units),
        }
        about |= self._about
        if self.group is not None:
            about["group"] = self.group
        if LABEL in columns and self.columns.labels:
            about["labels"] = {name: list(values) for name, values in self.columns.labels.items()}
        if self.offset.any():
            about["offset"] = [int(each) for each in self.offset]
        return about


def _table(source: Any, name: str) -> "TraceTable":  # noqa: ANN401 - as for Trace
    """Return the columns of a file or of a DataFrame."""
    import polars as pl  # noqa: PLC0415 - slow to import

    from connectors.files.container import read_table  # noqa: PLC0415 - slow to import
    from connectors.files.trace_table import TraceTable  # noqa: PLC0415 - slow to import

    if isinstance(source, str | Path):
        return read_table(Path(source))
    try:
        frame = source if isinstance(source, pl.DataFrame) else pl.DataFrame(source)
    except (TypeError, ValueError, OverflowError, pl.exceptions.PolarsError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(name, f"cannot become a DataFrame of polars: {reason:.200}") from None
    return TraceTable(frame, name)


def _motion(table: "TraceTable", columns: ColumnMap, times: Times) -> Motion:
    """Return the rows with a velocity; `times` are those of all rows."""
    velocity: Reals = np.full((len(times), 6), np.nan)
    for name in MOTIONS:
        if names := columns.columns.get(name):
            given = [table.reals(each) for each in names]
            velocity = np.pad(np.column_stack(given), ((0, 0), (0, 6 - len(given))))
            velocity[:, :3] *= columns.scale(name)
    moving: Flags = np.all(np.isfinite(velocity), axis=1)
    unknown = np.full((len(times), 6), np.nan)
    return Motion(times, times, velocity, unknown, finger=EVERY)[moving]

"""Recorded trace of one fingertip in a CSV file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final, TypeVar, cast

import numpy as np

from connectors.files.csv_columns import COUNTS, LABEL, SPEED, TIME, VELOCITY, ColumnMap
from operators.batch import EVERY, SLIP, UNKNOWN, Batch, Codes, Flags, Motion, Reals, Touch, Zeroed, s
from operators.checks import check_between
from operators.errors import InputError, ParameterError
from operators.fingertip import Fingertip, measured
from operators.ports import Description, Json

SomeBatch = TypeVar("SomeBatch", bound=Batch)

SLOWEST: Final = 5.0  # Hz; a rate outside these limits is implausible
FASTEST: Final = 5000.0  # Hz
MAX_SPEED: Final = 1.0  # m/s; a higher speed in contact is implausible

_INT16: Final = np.iinfo(np.int16)
_DEFAULT: Final = ColumnMap()


class CsvTrace:
    """`Recording` of one fingertip, and of the arm if the file has its speed, loaded completely and checked.

    Decimal times are converted exactly, then rounded to the nearest ns. Blank lines and other columns are
    ignored. All cells are valid; temperatures are 0 (unknown) and the arm's pose is NaN. A speed becomes
    a velocity along x of the base frame. A row without a velocity adds no row of motion.

    Args:
        path: The file; its first line names the columns.
        columns: Map of the columns; unmapped quantities are recognised by common column names.
        finger: Number of the fingertip.
        zeroed: Counts are relative to the unloaded fingertip; default: True if a count is negative.
        rate: Rows per second (Hz) of a file without a time column; its times start at 0.

    Attributes:
        columns: The completed map, without absent quantities.
        sha256: Checksum of the file, hex.
        touch: The whole trace, Touch or Zeroed.
        motion: Motion of the arm at the same instants; no rows if the file has none.
        labels: (n,) 1 slip, 0 static, -1 unknown.

    Raises:
        InputError: if the file cannot be read or has an invalid value; it names line and column.
        ParameterError: on an invalid rate or fingertip.
    """

    columns: ColumnMap
    touch: Touch
    motion: Motion
    labels: Codes

    def __init__(
        self,
        path: str | Path,
        columns: ColumnMap = _DEFAULT,
        *,
        finger: int = 0,
        zeroed: bool | None = None,
        rate: float | None = None,
    ) -> None:
        if rate is not None and not 0 < rate <= s:
            raise ParameterError("CsvTrace", "rate", rate, f"above 0 and at most {s:.0e} Hz")
        check_between("CsvTrace", "finger", finger, 0, _INT16.max)
        self._path = path
        from connectors.files.csv_table import CsvTable  # noqa: PLC0415 - polars is slow to import

        table = CsvTable(Path(path))
        self.sha256 = table.sha256
        self.columns = columns.completed(table.names, f"{table.where}, line 1", timed=rate is None)
        found = self.columns.columns
        if TIME in found:
            times = table.times(found[TIME][0], self.columns.units[TIME])
        else:
            times = np.rint(np.arange(len(table)) * (s / cast("float", rate))).astype(np.int64)
        least = 0 if zeroed is False else _INT16.min
        counts = [table.whole(name, least, _INT16.max) for name in found[COUNTS]]
        values = np.column_stack(counts).astype(np.int16)
        kind = Zeroed if zeroed or (zeroed is None and bool((values < 0).any())) else Touch
        temperature, valid = np.zeros_like(values), np.ones(values.shape, np.bool_)
        self.touch = kind(times, values, temperature, valid, finger=finger)
        velocity: Reals = np.full((len(times), 6), np.nan)
        for name in (VELOCITY, SPEED):
            if name in found:
                given = np.column_stack([table.reals(each) for each in found[name]])
                velocity = np.pad(given, ((0, 0), (0, 6 - given.shape[1])))
                velocity[:, :3] *= self.columns.scale(name)
        moving: Flags = np.all(np.isfinite(velocity), axis=1)
        unknown = np.full((len(times), 6), np.nan)
        self.motion = Motion(times, times, velocity, unknown, finger=EVERY)[moving]
        if LABEL in found:
            self.labels = table.whole(found[LABEL][0], UNKNOWN, SLIP).astype(np.int8)
        else:
            self.labels = np.full(len(times), UNKNOWN, np.int8)

    @property
    def name(self) -> str:
        """Path of the file."""
        return str(self._path)

    @property
    def kind(self) -> type[Touch]:
        """Type of the touch stream: Touch or Zeroed."""
        return type(self.touch)

    @property
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
            lines.append(
                f"the arm moves at up to {fastest:.3g} m/s: is its speed in another unit, such as mm/s?"
            )
        if rate is not None and not SLOWEST <= rate <= FASTEST:
            lines.append(f"the rate is {rate:.4g} Hz: is the time in another unit?")
        return tuple(lines)

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip: cells and rate of the file."""
        return measured(self.touch) if issubclass(kind, Touch) else None

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
        return {
            "trace": Path(self._path).name,
            "sha256": self.sha256,
            "rows": len(self.touch),
            "zeroed": self.kind is Zeroed,
            "columns": columns,
            "units": dict(self.columns.units),
        }

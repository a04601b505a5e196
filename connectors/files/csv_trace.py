"""Reading a recorded trace of one fingertip from a CSV file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final, TypeVar, cast

import numpy as np

from connectors.files.csv_columns import COUNTS, LABEL, SPEED, TIME, VELOCITY, ColumnMap
from operators.batch import EVERY, SLIP, UNKNOWN, Batch, Codes, Flags, Motion, Reals, Touch, Zeroed, s
from operators.errors import InputError, ParameterError
from operators.ports import Description, Json

SomeBatch = TypeVar("SomeBatch", bound=Batch)

DETECTORS: Final = 100.0  # Hz, that detectors are made for
OFF: Final = 0.1  # share that a rate may be off from the one that is expected
PLAUSIBLE: Final = 1.0  # m/s, that no arm exceeds while it feels something

_INT16: Final = np.iinfo(np.int16)
_GUESSED: Final = ColumnMap()


class CsvTrace:
    """A `Recording` of one fingertip, and of the arm if the file tells of it, read whole and checked.

    Times become ns exactly, by their decimal text, rounded to the nearest. Blank lines and other columns
    are ignored. What such a file does not tell is given as: every barometer valid, every temperature 0, which
    stands for unknown; the arm's pose NaN. A speed is taken for a velocity along x of the base frame. A row
    without a velocity has no row of motion.

    Args:
        path: the file; its first line names the columns.
        columns: which of them hold what; what it does not say is guessed where the names are usual.
        finger: the fingertip that the trace is of.
        zeroed: whether the counts are relative to the unloaded fingertip; by default they are if one of them
            is negative, which a raw count cannot be.
        rate: rows per second of a file that does not tell the time, which then begins at 0.

    Attributes:
        columns: the map, with what was guessed; without what there is none of.
        touch: Touch or Zeroed, the whole trace.
        motion: the arm's, at the same instants; no rows if the file does not tell.
        labels: (n,) 1 slip, 0 static, -1 unknown.

    Raises:
        InputError: naming line and column, if the file cannot be read or a value cannot be used.
        ParameterError: on a rate that is not above 0.
    """

    columns: ColumnMap
    touch: Touch
    motion: Motion
    labels: Codes

    def __init__(
        self,
        path: str | Path,
        columns: ColumnMap = _GUESSED,
        *,
        finger: int = 0,
        zeroed: bool | None = None,
        rate: float | None = None,
    ) -> None:
        if rate is not None and not 0 < rate <= s:
            raise ParameterError("CsvTrace", "rate", rate, f"above 0 and at most {s:.0e} Hz")
        self._path = path
        from connectors.files.csv_table import CsvTable  # noqa: PLC0415 - polars takes 0.2 s to import

        table = CsvTable(Path(path))
        self.sha256 = table.sha256
        self.columns = columns.completed(table.names, f"{table.where}, line 1", timed=rate is None)
        held = self.columns.columns
        if TIME in held:
            times = table.times(held[TIME][0], self.columns.units[TIME])
        else:
            times = np.rint(np.arange(len(table)) * (s / cast("float", rate))).astype(np.int64)
        least = 0 if zeroed is False else _INT16.min
        counts = [table.whole(name, least, _INT16.max) for name in held[COUNTS]]
        values = np.column_stack(counts).astype(np.int16)
        kind = Zeroed if zeroed or (zeroed is None and bool((values < 0).any())) else Touch
        temperature, valid = np.zeros_like(values), np.ones(values.shape, np.bool_)
        self.touch = kind(times, values, temperature, valid, finger=finger)
        velocity: Reals = np.full((len(times), 6), np.nan)
        for name in (VELOCITY, SPEED):
            if name in held:
                told = np.column_stack([table.reals(each) for each in held[name]])
                velocity = np.pad(told, ((0, 0), (0, 6 - told.shape[1])))
                velocity[:, :3] *= self.columns.scale(name)
        moving: Flags = np.all(np.isfinite(velocity), axis=1)
        unknown = np.full((len(times), 6), np.nan)
        self.motion = Motion(times, times, velocity, unknown, finger=EVERY)[moving]
        if LABEL in held:
            self.labels = table.whole(held[LABEL][0], UNKNOWN, SLIP).astype(np.int8)
        else:
            self.labels = np.full(len(times), UNKNOWN, np.int8)

    @property
    def name(self) -> str:
        """Path of the file."""
        return str(self._path)

    @property
    def kind(self) -> type[Touch]:
        """Touch or Zeroed, whichever it holds."""
        return type(self.touch)

    @property
    def rate(self) -> float | None:
        """Rows per second, by the median of their distances; None where all have one stamp."""
        distance = float(np.median(np.diff(self.touch.time))) if len(self.touch) > 1 else 0.0
        return s / distance if distance else None

    @property
    def speeds(self) -> Reals:
        """(n,) m/s, of the arm, at the rows of motion."""
        speeds: Reals = np.linalg.norm(self.motion.velocity[:, :3], axis=1)
        return speeds

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is hardly so, as where a unit is another than is thought, a line each."""
        lines = list[str]()
        fastest, rate = float(self.speeds.max(initial=0.0)), self.rate
        if fastest > PLAUSIBLE:
            lines.append(
                f"the arm would move at {fastest:.3g} m/s: is the unit of its speed another, as mm/s?"
            )
        if rate is not None and abs(rate / DETECTORS - 1) > OFF:
            made = f"detectors are made for {DETECTORS:g} Hz"
            lines.append(f"it comes at {rate:.4g} Hz, {made}: is the unit of its time another?")
        return tuple(lines)

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """The fingertip that it is of, if it holds what `kind` asks for; EVERY for the arm's motion."""
        streams = [stream for stream in (self.touch, self.motion) if len(stream)]
        return tuple(stream.finger for stream in streams if isinstance(stream, kind))

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """A stream of it in batches of at most `rows`.

        Raises:
            InputError: if it holds no such stream.
        """
        if finger not in self.fingers(kind):
            raise InputError(self.name, f"holds no {kind.__name__} stream of finger {finger}")
        stream = cast("SomeBatch", self.touch if isinstance(self.touch, kind) else self.motion)
        return (stream[start : start + rows] for start in range(0, len(stream), rows))

    def describe(self) -> Description:
        """The file's name and sha256, the number of its rows, what its columns were taken for."""
        columns: dict[str, Json] = {name: list(held) for name, held in self.columns.columns.items()}
        return {
            "trace": Path(self._path).name,
            "sha256": self.sha256,
            "rows": len(self.touch),
            "zeroed": self.kind is Zeroed,
            "columns": columns,
            "units": dict(self.columns.units),
        }

"""Recorded trace of fingertips, from a file or a DataFrame."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import numpy as np

from connectors.files.column_map import LABEL, ColumnMap
from operators.batch import EVERY, Batch, Motion, Reals, Touch, Zeroed
from operators.errors import InputError
from operators.fingertip import Fingertip
from operators.ports import Description, Json

if TYPE_CHECKING:
    from connectors.files.interpretation import Interpretation

SomeBatch = TypeVar("SomeBatch", bound=Batch)

_DEFAULT: Final = ColumnMap()


class Trace:
    """`Recording` of fingertips, and of the motion if there is one, loaded completely and checked.

    The file is read at the first access of an attribute: a flow can declare a trace without reading it.
    Decimal times are converted exactly, then rounded to the nearest ns. Other columns are ignored.
    Readings become whole counts of a `resolution`; if they do not fit in 16 bits, each cell has an offset. A
    missing reading is an invalid cell. Temperatures are 0 (unknown) and the arm's pose is NaN. A speed
    becomes a velocity along x of the base frame. A row without a velocity adds no row of motion.

    Args:
        source: A CSV or Parquet file, a polars or pandas DataFrame, a dictionary of arrays, or an
            interpretation of one.
        columns: Map of the columns; what it does not state is concluded from the data.
        name: Name of a DataFrame.
        group: Surface or object of the recording.
        about: Further entries of the description.
        part: Number of the part, of a recording of several episodes.

    Attributes:
        columns: The completed map: it states all, without absent quantities.
        sha256: Checksum of the file, hex; empty for a DataFrame.
        notes: Conclusions on how the data is read.
        warnings: Doubts about implausible values, such as a wrong unit, one line each.
        offset: (cells,) counts of the first fingertip; a reading is (count + offset) x resolution.
        missing: Number of missing readings.
        touch: Rows of the first fingertip, Touch or Zeroed.
        motion: Motion of the arm; no rows if there is none.
        labels: (n,) 1 slip, 0 static, -1 unknown.
        rate: Rows per second; None: unknown.

    Raises:
        InputError: if the file cannot be read, or has invalid values or several parts; it lists all problems.
        ParameterError: if the layout or the range does not fit the cells.
    """

    def __init__(
        self,
        source: "Any | Interpretation",
        columns: ColumnMap = _DEFAULT,
        *,
        name: str = "table",
        group: str | None = None,
        about: Description | None = None,
        part: int | None = None,
    ) -> None:
        self.group, self._about, self._unread = group, about or {}, (source, columns, name, part)
        if isinstance(source, str | Path):
            self.name = str(source)

    def __getattr__(self, name: str) -> Any:
        """Read the recording, at the first access of one of its attributes."""
        if name.startswith("__") or (unread := vars(self).pop("_unread", None)) is None:
            raise AttributeError(name)
        try:
            self._read(*unread)
        except BaseException:
            self._unread = unread
            raise
        return getattr(self, name)

    def _read(self, source: object, columns: ColumnMap, name: str, part: int | None) -> None:
        from connectors.files.decoding import described
        from connectors.files.plausibility import gap_doubts, motion_doubts

        found = interpreted(source, columns, name=name)
        if part is None and len(found.decoded) > 1:
            reason = f"has {len(found.decoded)} episodes: slipflow import makes a session of each"
            raise InputError(found.table.file, reason)
        rows = found.decoded[part or 0]
        self.name, self.sha256 = found.table.file, found.table.sha256
        self.columns, self.notes, self.stated = found.columns, found.notes, found.stated
        self.rate = found.axis.rate
        self._touch, self.motion, self.labels = rows.touch, rows.motion, rows.labels
        self.touch = next(iter(rows.touch.values()))
        self.offset = np.resize(self.columns.offset or (0,), self.touch.cells)
        self._fingertip = described(self.columns) if self.columns.rate else None
        self.missing = sum(int(np.count_nonzero(~each.valid)) for each in rows.touch.values())
        doubts = [*motion_doubts(self.speeds), *found.warnings]
        if self.missing:
            bad = np.any([~each.valid.all(axis=1) for each in rows.touch.values()], axis=0)
            doubts.append(f"missing readings: {self.missing}, in {np.count_nonzero(bad)} of {len(bad)} rows")
        self.warnings = (*doubts, *gap_doubts(rows.time, self.rate))

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest reading, in the unit of the counts."""
        counts, valid = (
            np.concatenate([getattr(each, name) for each in self._touch.values()], axis=1)
            for name in ("counts", "valid")
        )
        readings = (counts + np.array(self.columns.offset or 0))[valid]
        return float(readings.min() * self.resolution), float(readings.max() * self.resolution)

    @property
    def kind(self) -> type[Touch]:
        """Type of the touch stream: Touch or Zeroed."""
        return type(self.touch)

    @property
    def resolution(self) -> float:
        """Units per count."""
        return self.columns.resolution or 1.0

    @property
    def speeds(self) -> Reals:
        """Speed of the arm in each row of motion, (n,) m/s."""
        speeds: Reals = np.linalg.norm(self.motion.velocity[:, :3], axis=1)
        return speeds

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip: cells, rate, unit and resolution of the file, layout and range as given."""
        return self._fingertip if issubclass(kind, Touch) else None

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """Return the fingers with a stream of a type; EVERY for the arm's motion."""
        if issubclass(kind, Touch):
            return tuple(
                finger for finger, rows in self._touch.items() if len(rows) and isinstance(rows, kind)
            )
        return (EVERY,) if kind is Motion and len(self.motion) else ()

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """Yield a stream in batches of at most `rows`.

        Raises:
            InputError: if there is no such stream.
        """
        if finger not in self.fingers(kind):
            raise InputError(self.name, f"has no {kind.__name__} stream of finger {finger}")
        stream = cast("SomeBatch", self._touch[finger] if issubclass(kind, Touch) else self.motion)
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


def interpreted(
    source: "Any | Interpretation",
    columns: ColumnMap = _DEFAULT,
    *,
    name: str = "table",
    split: bool = False,
) -> "Interpretation":
    """Return the interpretation of a file or of a DataFrame.

    Args:
        source: As of a `Trace`.
        columns: Map of the columns.
        name: Name of a DataFrame.
        split: A clock that starts again begins another part, which is a trace of its own.

    Raises:
        InputError: if it cannot be read; it lists all problems.
    """
    import polars as pl

    from connectors.files.container import read_table
    from connectors.files.interpretation import Interpretation, interpret
    from connectors.files.raw_table import RawTable

    if isinstance(source, Interpretation):
        return source
    if isinstance(source, str | Path):
        return interpret(read_table(Path(source), columns.separator), columns, split=split)
    try:
        source = _upright(source) if isinstance(source, Mapping) else source
        frame = source if isinstance(source, pl.DataFrame) else pl.DataFrame(source)
    except (TypeError, ValueError, OverflowError, pl.exceptions.PolarsError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(name, f"cannot become a DataFrame of polars: {reason:.200}") from None
    return interpret(RawTable.of(frame, name), columns, split=split)


def _upright(arrays: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return arrays with a row per time; those of MATLAB may have a row per channel: all end alike."""
    found = {name: np.asarray(values) for name, values in arrays.items()}
    shapes = [each.shape for each in found.values() if each.ndim]
    rows = {shape[-1] for shape in shapes}
    if len(rows) > 1 or all(shape[0] in rows for shape in shapes):
        return arrays
    return {name: each.T.squeeze() if each.ndim > 1 else each for name, each in found.items()}

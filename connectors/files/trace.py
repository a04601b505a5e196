"""Recorded trace of fingertips, from a file or a DataFrame."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import numpy as np

from connectors.files.column_map import LABEL, ColumnMap
from operators.batch import EVERY, Batch, Motion, Touch
from operators.errors import InputError
from operators.fingertip import Fingertip
from operators.ports import Description, Json

if TYPE_CHECKING:
    from connectors.files.interpretation import Part

SomeBatch = TypeVar("SomeBatch", bound=Batch)

_DEFAULT: Final = ColumnMap()


class Trace:
    """`Recording` of fingertips, and of the motion if there is one, loaded completely and checked.

    The file is read at the first access of `part`, not by the declaration of a flow. Other columns are
    ignored. Readings become whole counts of a `resolution`; if they do not fit in 16 bits, each cell has an
    offset. A missing reading is an invalid cell. Temperatures are 0 (unknown) and the pose is NaN. A speed
    becomes a velocity along x of the base frame. A row without a velocity adds no row of motion.

    Args:
        source: A CSV or Parquet file, a polars or pandas DataFrame, a dictionary of arrays, or a part of an
            interpretation.
        columns: Map of the columns; the rest is concluded from the data.
        name: Name of a DataFrame.
        about: Further entries of the description, such as ``group``, the surface or object.

    Attributes:
        part: All that was read and concluded: `touch`, `motion`, `labels`, `columns`, `warnings` and more.

    Raises:
        InputError: if the file cannot be read, or has invalid values; it lists all problems.
        ParameterError: if the layout or the range does not fit the cells.
    """

    def __init__(
        self,
        source: "Any | Part",
        columns: ColumnMap = _DEFAULT,
        *,
        name: str = "table",
        about: Description | None = None,
    ) -> None:
        self._source, self._columns = source, columns
        self.name = str(source) if isinstance(source, str | Path) else name
        self._about = about or {}

    @cached_property
    def part(self) -> "Part":
        """All that was read and concluded."""
        [part] = interpreted(self._source, self._columns, name=self.name)
        return part

    def fingertip(self, kind: type[Batch]) -> Fingertip | None:
        """Return the fingertip: cells, rate, unit and resolution of the file, layout and range as given."""
        return self.part.fingertip if issubclass(kind, Touch) else None

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """Return the fingers with a stream of a type; EVERY for the arm's motion."""
        if issubclass(kind, Touch):
            found = self.part.fingertips.items()
            return tuple(finger for finger, rows in found if len(rows) and isinstance(rows, kind))
        return (EVERY,) if kind is Motion and len(self.part.motion) else ()

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """Yield a stream in batches of at most `rows`.

        Raises:
            InputError: if there is no such stream.
        """
        if finger not in self.fingers(kind):
            raise InputError(self.name, f"has no {kind.__name__} stream of finger {finger}")
        found = self.part.fingertips[finger] if issubclass(kind, Touch) else self.part.motion
        stream = cast("SomeBatch", found)
        return (stream[start : start + rows] for start in range(0, len(stream), rows))

    def describe(self) -> Description:
        """Return the name, sha256 and number of rows of the file, and the map of its columns."""
        part, found = self.part, self.part.columns
        about: dict[str, Json] = {
            "trace": Path(self.name).name,
            "sha256": part.sha256,
            "rows": len(part.touch),
            "zeroed": bool(found.zeroed),
            "columns": {name: list(names) for name, names in found.columns.items()},
            "units": dict(found.units),
            **self._about,
        }
        about |= {"labelled": found.labelled} if found.labelled else {}
        about |= {"missing": [*found.missing]} if found.missing else {}
        if LABEL in found.columns and found.labels:
            about["labels"] = {name: list(values) for name, values in found.labels.items()}
        about |= {"offset": [int(each) for each in part.offset]} if part.offset.any() else {}
        return about


def interpreted(
    source: "Any | Part", columns: ColumnMap = _DEFAULT, *, name: str = "table", split: bool = False
) -> "list[Part]":
    """Return the parts of a source as of a `Trace`; `split`: a clock that starts again begins another one.

    Raises:
        InputError: if it cannot be read; it lists all problems.
    """
    import polars as pl

    from connectors.files.container import read_table
    from connectors.files.interpretation import Part, interpret
    from connectors.files.raw_table import RawTable

    if isinstance(source, Part):
        return [source]
    if isinstance(source, str | Path):
        return interpret(read_table(Path(source), columns.separator), columns, split=split)
    try:
        source = _upright(source) if isinstance(source, Mapping) else _with_index(source)
        frame = source if isinstance(source, pl.DataFrame) else pl.DataFrame(source, infer_schema_length=None)
    except (TypeError, ValueError, OverflowError, pl.exceptions.PolarsError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(name, f"cannot become a DataFrame of polars: {reason:.200}") from None
    return interpret(RawTable.of(frame, name), columns, split=split)


def _with_index(frame: Any) -> Any:
    """Return a pandas DataFrame whose index, if it has times or a name, is a column."""
    index: Any = getattr(frame, "index", None)
    if not hasattr(index, "names") or ([*index.names] == [None] and not hasattr(index, "freq")):
        return frame
    named = frame if any(index.names) else frame.rename_axis("timestamp")
    twice = [name for name in named.index.names if name in named.columns]
    return named.reset_index(twice, drop=True).reset_index(drop=len(twice) == len(named.index.names))


def _upright(arrays: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return arrays with a row per time; those of MATLAB may have a row per channel: all end alike."""
    found = {name: np.asarray(values) for name, values in arrays.items()}
    shapes = [each.shape for each in found.values() if each.ndim]
    rows = {shape[-1] for shape in shapes}
    if len(rows) > 1 or all(shape[0] in rows for shape in shapes):
        return arrays
    return {name: each.T.squeeze() if each.ndim > 1 else each for name, each in found.items()}

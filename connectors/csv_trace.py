"""Reading a recorded trace of one fingertip from a CSV file."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from operators.batch import BAROMETERS, SLIP, UNKNOWN, Batch, Codes, Touch, Zeroed
from operators.errors import InputError, ParameterError
from operators.ports import Description

SomeBatch = TypeVar("SomeBatch", bound=Batch)

_TIMES = (("t",), ("time",), ("time_ns",))
_COUNTS = (("s1", "s2", "s3", "s4", "s5", "s6"), ("c0", "c1", "c2", "c3", "c4", "c5"))
_LABEL = "label"
_INT16 = np.iinfo(np.int16)


class CsvTrace:
    """A `Recording` of one fingertip, read whole and checked when it is made.

    Seconds become ns exactly, by their decimal text, rounded to the nearest. Blank lines and other columns
    are ignored. What such a file does not tell is given as: every barometer valid, every temperature 0, which
    stands for unknown.

    Args:
        path: the file; its first line names the columns.
        time: column of the time, in ns if its name ends in ``_ns``, else in s; by default ``t``, ``time`` or
            ``time_ns``.
        counts: columns of the barometers 0..5; by default ``s1`` .. ``s6`` or ``c0`` .. ``c5``.
        label: column of the labels; by default ``label``, if there is one.
        finger: the fingertip that the trace is of.
        zeroed: whether the counts are relative to the unloaded fingertip; by default they are if one of them
            is negative, which a raw count cannot be.

    Attributes:
        touch: Touch or Zeroed, the whole trace.
        labels: (n,) 1 slip, 0 static, -1 unknown.

    Raises:
        InputError: naming line and column, if the file cannot be read or a value cannot be used.
    """

    touch: Touch
    labels: Codes

    def __init__(
        self,
        path: str | Path,
        *,
        time: str | None = None,
        counts: Sequence[str] | None = None,
        label: str | None = None,
        finger: int = 0,
        zeroed: bool | None = None,
    ) -> None:
        if counts is not None and len(counts) != BAROMETERS:
            raise ParameterError("CsvTrace", "counts", counts, f"{BAROMETERS} column names")
        self._path = path
        from connectors.csv_table import CsvTable  # noqa: PLC0415 - polars takes 0.2 s to import

        table = CsvTable(Path(path))
        times = table.times(*table.choose([(time,)] if time else _TIMES))
        least = 0 if zeroed is False else _INT16.min
        names = table.choose([tuple(counts)] if counts else _COUNTS)
        values = np.column_stack([table.whole(name, least, _INT16.max) for name in names]).astype(np.int16)
        kind = Zeroed if zeroed or (zeroed is None and bool((values < 0).any())) else Touch
        temperature, valid = np.zeros_like(values), np.ones(values.shape, np.bool_)
        self.touch = kind(times, values, temperature, valid, finger=finger)
        if label or _LABEL in table.names:
            (label,) = table.choose([(label or _LABEL,)])
            self.labels = table.whole(label, UNKNOWN, SLIP).astype(np.int8)
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

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        """The fingertip that it is of, if it holds what `kind` asks for."""
        return (self.touch.finger,) if issubclass(self.kind, kind) else ()

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        """The trace in batches of at most `rows`.

        Raises:
            InputError: if it holds no such stream.
        """
        if finger not in self.fingers(kind):
            raise InputError(self.name, f"holds no {kind.__name__} stream of finger {finger}")
        touch = cast("SomeBatch", self.touch)
        return (touch[start : start + rows] for start in range(0, len(touch), rows))

    def describe(self) -> Description:
        """File, number of rows, and whether they are zeroed."""
        return {"trace": self.name, "rows": len(self.touch), "zeroed": self.kind is Zeroed}

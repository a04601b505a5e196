"""Operators as steps: functions of one row, which a `Segment` fuses into one compiled call per batch.

A step is ``step(settings, state, row, out) -> bool``. It reads `row` and `settings`, updates `state`,
writes `out`, and returns True or False: whether there is an output row. It must set `out.time` and every
other column of that row: a column that it leaves out keeps its last value.

An operator that gives several rows for one, or holds rows back, has ``take(settings, state, row)`` instead,
called once per row, and ``give(settings, state, out) -> bool``, called until it returns False. A join has
one `take` per input.

All arguments are records, whose fields are attributes: `row.time`, `row.counts[cell]`. Steps are compiled
where numba is installed; elsewhere they run as Python and give the same bits, if they compute with
`int(...)`, `float(...)` and `math`, within these limits: all values are finite, integers have 64 bits, a
column or a state gets a value in its range, exponents of integers are not negative, and `round` has one
argument. Beyond them Python raises an error or goes on with longer integers, where compiled code returns
another value without notice. The functions that they call are compiled with them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import floor
from types import FunctionType
from typing import Any, Final, NamedTuple, TypeAlias, cast

import numpy as np

from operators.batch import BAROMETERS, Batch, packed_type

Record: TypeAlias = Any  # its fields are attributes
Values: TypeAlias = Mapping[str, Any]  # numbers and arrays
END: Final = 2**62  # ns, later than any stamp
_RATE: Final = 1000  # rows per second that queues of rows are made for
_LEAST: Final = 1024  # rows of a queue


class RowType(NamedTuple):
    """Type of the rows of one fingertip."""

    kind: type[Batch]
    cells: int = BAROMETERS

    @property
    def packed(self) -> np.dtype[Any]:
        """Type of a packed row."""
        return packed_type(self.kind, self.cells)


@dataclass(frozen=True)
class Steps:
    """Functions of an operator, with the names and initial values of what they keep.

    Args:
        settings: Values that never change, the same for all fingertips.
        state: Initial values of the state of one fingertip. If it has `ended`, that becomes 1 when the stream
            ends, and `give` is called again.
        step: Function of one row; None: `takes` and `give` are used.
        takes: Functions that take a row of each input.
        give: Function that gives a row, if there is one.
        held: Largest number of rows that are given after the input for them was taken.
        factor: Largest number of rows per input row.
    """

    settings: Values = field(default_factory=dict[str, Any])
    state: Values = field(default_factory=dict[str, Any])
    step: Callable[[Record, Record, Record, Record], bool] | None = None
    takes: tuple[Callable[[Record, Record, Record], None], ...] = ()
    give: Callable[[Record, Record, Record], bool] | None = None
    held: int = 0
    factor: int = 1

    def functions(self) -> list[FunctionType]:
        """Return all functions."""
        return [cast("FunctionType", each) for each in (*self.takes, self.step, self.give) if each]


def record_type(values: Values) -> np.dtype[Any]:
    """Return the type of a record with these values; flags are bytes.

    >>> record_type({"length": 3, "level": 0.5}).names
    ('length', 'level')
    """
    fields: list[Any] = []
    for name, value in values.items():
        array = np.asarray(value)
        kind = np.dtype(np.uint8) if array.dtype == np.bool_ else array.dtype
        fields.append((name, kind, array.shape))
    return np.dtype(fields or [("none", np.uint8)], align=True)


def queue(row: RowType, time: int) -> "np.ndarray[Any, Any]":
    """Return room for the rows of a time (ns) at up to 1 kHz; the number is a power of two.

    >>> from operators.batch import Scores, s
    >>> queue(RowType(Scores), 2 * s).size
    2048
    """
    rows = max(_LEAST, time * _RATE // 1_000_000_000)
    return np.zeros(1 << (rows - 1).bit_length(), row.packed)


def copy(out: Record, row: Record) -> None:
    """Copy the columns that both rows have; they are the first ones of both, those of a common base."""
    for name in out.dtype.names:
        if name in row.dtype.names:
            out[name] = row[name]


def nearest_count(value: float) -> int:
    """Return the whole count nearest to a finite value; of two, the greater.

    >>> nearest_count(-2.5), nearest_count(1e9)
    (-2, 32767)
    """
    return floor(min(max(value + 0.5, -32768.0), 32767.0))

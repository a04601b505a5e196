"""Batches: rows of one type, as columns with a common first axis or as one array of packed rows.

The same code processes batches of one row, in a live run, and of a million rows, in a replay. Either form
is made from the other when it is first read: operators of slipflow take and give packed rows, so that a batch
of one row needs a single array; users' code and files read columns.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import field
from functools import cache, cached_property
from operator import attrgetter, index
from typing import Any, Final, Literal, Self, TypeAlias, TypeVar, cast, get_args

import numpy as np
from numpy.typing import NDArray

from operators.column import CELLS, Column, Declared, column, declared
from operators.errors import BatchError

Times: TypeAlias = NDArray[np.int64]  # ns since 1970-01-01 UTC
Counts: TypeAlias = NDArray[np.int16]  # ADC counts of a barometer
Flags: TypeAlias = NDArray[np.bool_]
Codes: TypeAlias = NDArray[np.int8]
Reals: TypeAlias = NDArray[np.float64]

BAROMETERS: Final = 6  # cells of a TakkTile fingertip
EVERY: Final = -1  # finger of a batch that belongs to all fingertips, such as the arm's motion
SLIP: Final = 1
STATIC: Final = 0
UNKNOWN: Final = -1
MotionKind: TypeAlias = Literal["translation", "rotation", "hold", "tap", "lift"]
Curvature: TypeAlias = Literal["plane", "sphere", "cylinder_x", "cylinder_y"]
MOTIONS: Final[tuple[str, ...]] = get_args(MotionKind)
SURFACES: Final[tuple[str, ...]] = get_args(Curvature)
us: Final = 1_000  # ns
ms: Final = 1_000_000  # ns
s: Final = 1_000_000_000  # ns
minute: Final = 60 * s  # ns


class Batch(Declared):
    """Rows of one type, in order of arrival: a row may be late, older than one before it."""

    time: Times = column(np.int64, unit="ns")  # (n,) event time
    finger: int = field(default=EVERY, kw_only=True)  # fingertip of all rows

    def __post_init__(self) -> None:
        cast("Any", self).finger = index(self.finger)  # an integer of numpy lacks methods of int

    @classmethod
    def unpack(cls, packed: NDArray[Any], finger: int = EVERY) -> Self:
        """Return a batch of packed rows, (n,) of `packed_type`.

        >>> Scores.unpack(np.array([(1, 0.5)], packed_type(Scores))).probability
        array([0.5])
        """
        batch: Any = _new(cls)
        batch.packed, batch.finger = packed, index(finger)  # set so, they need no dictionary
        return cast("Self", batch)

    @classmethod
    def rows(cls, *values: Any, finger: int = EVERY) -> Self:
        """Return packed rows of these columns, as a source yields them; lists serve as well as arrays.

        Raises:
            BatchError: if whole numbers are fractions or out of the range of their column.

        >>> Scores.rows([1, 2], 0.5).probability
        array([0.5, 0.5])
        """
        names = columns(cls)
        shapes = (np.shape(v) for v, c in zip(values, names.values(), strict=True) if CELLS in c.shape)
        cells = next((shape[-1] for shape in shapes if len(shape) > 1), BAROMETERS)
        rows = np.zeros(len(values[0]), packed_type(cls, cells))
        for name, value in zip(names, values, strict=True):
            _store(cls, rows, name, value if len(rows) else 0)
        return cls.unpack(rows, finger)

    def later(self, by: int) -> Self:
        """Return a copy of the rows with later times, by ns."""
        rows = self.packed.copy()
        rows["time"] += by
        return type(self).unpack(rows, self.finger)

    @cached_property
    def packed(self) -> NDArray[Any]:
        """Rows as one array, (n,) of `packed_type`."""
        return pack(self, packed_type(type(self), self.cells))

    def __len__(self) -> int:
        rows = vars(self).get("packed")
        return len(self.time if rows is None else rows)

    @property
    def cells(self) -> int:
        """Number of cells of the fingertip; 0 if the type has no column per cell."""
        name = layout(type(self)).cell_column
        return int(getattr(self, name).shape[-1]) if name else 0

    def __getitem__(self, rows: slice | Flags | NDArray[np.intp]) -> Self:
        """Return rows by slice (as views), or by flags or indices (as copies)."""
        kind = type(self)
        if "packed" in vars(self):
            return kind.unpack(self.packed[rows], self.finger)
        return kind(*[column[rows] for column in layout(kind).take(self)], finger=self.finger)

    @classmethod
    def empty(cls) -> Self:
        """Return a batch without rows.

        >>> Touch.empty().counts.shape
        (0, 6)
        """
        return cast("Self", _empty(cls))

    @classmethod
    def zeros(cls, rows: int = 1, cells: int = BAROMETERS) -> Self:
        """Return a batch of zeros."""
        shapes = [(c.dtype, (rows, *c.sizes(cells))) for c in columns(cls).values()]
        return cls(*(np.zeros(shape, dtype) for dtype, shape in shapes))

    def check(self) -> Self:
        """Return this batch if the type and shape of each column are valid.

        Raises:
            BatchError: if a column is invalid.
        """
        expected, rows = layout(type(self)), vars(self).get("packed")
        if rows is not None and rows.dtype is expected.row:
            return self
        if rows is not None and rows.dtype == packed_type(type(self), self.cells):
            expected.row = rows.dtype
            return self
        try:
            traits = expected.traits(self)
        except AttributeError:  # a column is not an array
            return self._check_each()
        if traits != expected.valid:
            self._check_each()
            expected.valid = traits
        return self

    def is_ordered(self) -> bool:
        """Return True if time never decreases."""
        time = self.time
        return bool((time[1:] >= time[:-1]).all())

    def check_order(self) -> Self:
        """Return this batch if its time never decreases.

        Raises:
            BatchError: if it does.
        """
        if len(self) > 1 and not self.is_ordered():
            row = int(np.argmax(self.time[1:] < self.time[:-1])) + 1
            reason = f"decreases at row {row}, must be in order: sort the rows, or yield them one by one"
            raise BatchError(type(self).__name__, "time", reason)
        return self

    def _check_each(self) -> Self:
        """Check the columns one by one; the error names the invalid one."""
        kind, length, cells = type(self).__name__, next(iter(np.shape(self.time)), 0), CELLS
        for name, expected in columns(type(self)).items():
            value: NDArray[Any] = getattr(self, name)
            is_array: bool = isinstance(getattr(self, name), np.ndarray)
            if not is_array or value.dtype != expected.dtype:
                found = value.dtype if is_array else type(value).__name__
                raise BatchError(kind, name, f"is {found}, must be an array of {expected.dtype}")
            shape = value.shape
            wanted = (length, *(cells if size == CELLS else size for size in expected.shape))
            if len(shape) != len(wanted) or any(
                want >= 0 and want != have for want, have in zip(wanted, shape, strict=True)
            ):
                want = ", ".join(str(size) if size >= 0 else "any" for size in wanted)
                raise BatchError(kind, name, f"has shape {shape}, must be ({want})")
            if CELLS in expected.shape:
                cells = shape[-1]
        return self


AnyBatch = TypeVar("AnyBatch", bound=Batch)


class Layout:
    """Cached column types and shapes of a batch type, for operations on every batch."""

    def __init__(self, kind: type[Batch]) -> None:
        expected = columns(kind)
        traits = "__class__", "dtype", "shape"  # of each column
        self.traits = attrgetter(*(f"{name}.{trait}" for name in expected for trait in traits))
        self.valid: object = None  # traits of the newest valid batch
        self.row: object = None  # type of the rows of the newest valid packed batch
        self.cell_column = next((name for name, each in expected.items() if CELLS in each.shape), None)
        getter = attrgetter(*expected)
        self.take: Callable[[Batch], tuple[NDArray[Any], ...]] = (
            getter if len(expected) > 1 else lambda batch: (batch.time,)
        )


def pack(batch: Batch, row: np.dtype[Any]) -> NDArray[Any]:
    """Return the rows of a batch as one array; columns that the row lacks are left out.

    Raises:
        BatchError: if a column of whole numbers has values that are fractions or out of its range.
    """
    rows = np.zeros(len(batch), row)
    for name in row.names or ():
        _store(type(batch), rows, name, getattr(batch, name))
    return rows


def _store(kind: type[Batch], rows: NDArray[Any], name: str, value: Any) -> None:
    """Store a column in packed rows, unless that would change whole numbers."""
    stored: NDArray[Any] = rows[name]
    stored[...] = value
    wanted = stored.dtype
    if wanted.kind == "i" and getattr(value, "dtype", None) is not wanted and np.any(stored != value):
        raise BatchError(kind.__name__, name, f"has values that {wanted} cannot hold")


def packed_type(kind: type[Batch], cells: int = BAROMETERS) -> np.dtype[Any]:
    """Return the type of a packed row of a fingertip with this number of cells; the same object each time.

    A subtype begins with the columns of its base. Flags are bytes: numba has no records with arrays of flags.
    """
    return _packed_type(cast("Any", kind), cells if layout(kind).cell_column else 0)


@cache
def _packed_type(kind: type[Any], cells: int) -> np.dtype[Any]:
    flag, byte = np.dtype(np.bool_), np.dtype(np.uint8)
    return np.dtype(
        [(n, byte if c.dtype == flag else c.dtype, c.sizes(cells)) for n, c in columns(kind).items()],
        align=True,
    )


_new: Final = object.__new__
_empty: Final[Callable[[type[Batch]], Batch]] = cast("Any", cache(lambda kind: kind.zeros(0)))
layout: Final[Callable[[type[Batch]], Layout]] = cast("Any", cache(Layout))  # of a batch type


def columns(kind: type[Batch]) -> Mapping[str, Column]:
    """Return the array columns of a batch type, in order.

    >>> list(columns(Motion))
    ['time', 'device_time', 'velocity', 'pose']
    """
    return declared[kind]


def concat(kind: type[AnyBatch], batches: Iterable[AnyBatch]) -> AnyBatch:
    """Concatenate batches of one fingertip; empty ones are skipped.

    Raises:
        BatchError: if the batches belong to several fingertips.
    """
    full = [batch for batch in batches if batch.time.size]
    if len(full) == 1:
        return full[0]
    if not full:
        return kind.empty()
    if len({batch.finger for batch in full}) > 1:
        raise BatchError(kind.__name__, "finger", "cannot concatenate batches of several fingertips")
    if all("packed" in vars(batch) and type(batch) is kind for batch in full):
        return kind.unpack(np.concatenate([batch.packed for batch in full]), full[0].finger)
    parts = zip(*map(layout(kind).take, full), strict=True)  # arrays of each column
    return kind(*map(np.concatenate, parts), finger=full[0].finger)


class Touch(Batch):
    """Raw readings of one fingertip's cells; `Fingertip` states their layout, rate, unit and range."""

    counts: Counts = column(np.int16, CELLS, unit="count")  # (n, cells)
    temperature: Counts = column(np.int16, CELLS, unit="count")  # (n, cells) raw ADC
    # (n, cells) False: the cell did not answer, or the value is implausible
    valid: Flags = column(np.bool_, CELLS)


class Zeroed(Touch):
    """Touch with counts relative to the unloaded fingertip; of a TakkTile, negative means more pressure."""


class Motion(Batch):
    """Motion of the arm's tool centre point (TCP), in the robot's base frame."""

    device_time: Times = column(np.int64, unit="ns")  # (n,) stamp of the controller
    velocity: Reals = column(np.float64, 6, unit="m/s, rad/s")  # (n, 6) linear, angular
    pose: Reals = column(np.float64, 6, unit="m, rad")  # (n, 6) rotation vector; NaN unknown


class Sample(Zeroed):
    """Zeroed touch with the arm's motion at the same time; NaN in unmatched rows."""

    velocity: Reals = column(np.float64, 6, unit="m/s, rad/s")  # (n, 6) base frame
    pose: Reals = column(np.float64, 6, unit="m, rad")  # (n, 6) base frame
    matched: Flags = column(np.bool_)  # (n,) False: no motion close enough in time


class Labelled(Sample):
    """Sample with a label derived from the arm's motion."""

    speed: Reals = column(np.float64, unit="m/s")  # (n,) in the contact plane; NaN unknown
    label: Codes = column(np.int8, unit="1 slip, 0 static, -1 unknown")  # (n,)


class Windows(Batch):
    """Window of samples that ends at each time, newest last; read-only views of one buffer."""

    counts: Counts = column(np.int16, -1, CELLS, unit="count")  # (n, length, cells)
    valid: Flags = column(np.bool_, -1, CELLS)  # (n, length, cells)


class Scores(Batch):
    """Probability of slip at each time, from a detector."""

    probability: Reals = column(np.float64)  # (n,) 0 to 1; NaN unknown


class Slips(Batch):
    """Slip events: one row per onset and one per end."""

    state: Codes = column(np.int8, unit="1 onset, 0 end")  # (n,)
    start: Times = column(np.int64, unit="ns")  # (n,) first decision of the onset or end
    probability: Reals = column(np.float64)  # (n,) at `time`


class Faults(Batch):
    """Starts and ends of faults of single cells."""

    barometer: Codes = column(np.int8)  # (n,) number of the cell
    kind: Codes = column(np.int8)  # (n,) `FaultKind`
    active: Flags = column(np.bool_)  # (n,) True: start, False: end


class Commands(Batch):
    """Commands to the hand from `time` on."""

    force: Reals = column(np.float64, unit="N")  # (n,) normal force, at least 0; NaN: unchanged


class Episodes(Batch):
    """Motions of the arm, such as one stroke over a surface; `time` is the start."""

    end: Times = column(np.int64, unit="ns")  # (n,) first instant after it
    motion: Codes = column(np.int8, names=MOTIONS)  # (n,)
    surface: Codes = column(np.int8, names=SURFACES)  # (n,)
    # (n,) of a translation or tap, in the fingertip's plane, anticlockwise from x
    direction: Reals = column(np.float64, unit="rad")
    speed: Reals = column(np.float64, unit="m/s")  # (n,) along the direction
    angular_speed: Reals = column(np.float64, unit="rad/s")  # (n,) anticlockwise
    depth: Reals = column(np.float64, unit="m")  # (n,) beyond first contact; NaN unknown
    force: Reals = column(np.float64, unit="N")  # (n,) normal, at the start; NaN unknown


class Truth(Batch):
    """State of the simulated contact at the true instant of each touch sample, for tests and evaluation."""

    # (n,) mean over the pad since the last row
    sliding: Reals = column(np.float64, unit="m/s")
    force: Reals = column(np.float64, unit="N")  # (n,) normal
    # (n, 3) arm at the pad's centre, with its vibration: x, y, about the normal
    velocity: Reals = column(np.float64, 3, unit="m/s, rad/s")


ANNOTATIONS: Final[tuple[type[Batch], ...]] = (Episodes, Truth)  # streams that a recording may lack

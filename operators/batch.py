"""Batches: typed columns of numpy arrays with a common first axis.

The same code processes batches of one row, in a live run, and of a million rows, in a replay.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, dataclass, field, fields
from inspect import get_annotations
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final, Self, TypeAlias, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import DTypeLike, NDArray

from operators.errors import BatchError
from operators.row_loop import row_loop

Times: TypeAlias = NDArray[np.int64]  # ns since 1970-01-01 UTC
Counts: TypeAlias = NDArray[np.int16]  # ADC counts of a barometer
Flags: TypeAlias = NDArray[np.bool_]
Codes: TypeAlias = NDArray[np.int8]
Reals: TypeAlias = NDArray[np.float64]

BAROMETERS: Final = 6  # cells of a TakkTile fingertip
CELLS: Final = -2  # size of a column: the number of cells, the same in all columns of a batch
EVERY: Final = -1  # finger of a batch that belongs to all fingertips, such as the arm's motion
SLIP: Final = 1
STATIC: Final = 0
UNKNOWN: Final = -1
MOTIONS: Final = ("translation", "rotation", "hold", "tap", "lift")
SURFACES: Final = ("plane", "sphere", "cylinder_x", "cylinder_y")
us: Final = 1_000  # ns
ms: Final = 1_000_000  # ns
s: Final = 1_000_000_000  # ns
minute: Final = 60 * s  # ns


@dataclass(frozen=True)
class Column:
    """Element type, shape of one row (-1: any length; `CELLS`: one value per cell) and unit of one field."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    unit: str
    names: tuple[str, ...] = ()  # names of the codes 0, 1, ..., which files store; empty: not coded

    def sizes(self, cells: int) -> tuple[int, ...]:
        """Return the shape of one row of a fingertip with this number of cells; any length is 0."""
        return tuple(cells if size == CELLS else max(size, 0) for size in self.shape)


def column(dtype: DTypeLike, *shape: int, unit: str = "", names: tuple[str, ...] = ()) -> Any:
    """Declare a column of a batch type; checks, empty batches and Arrow schemas are derived from it.

    >>> class Force(Batch):
    ...     normal: Reals = column(np.float64, unit="N")  # (n,)
    >>> Force.zeros(rows=2).normal
    array([0., 0.])
    """
    return field(metadata={"column": Column(np.dtype(dtype), shape, unit, names)})


_columns: Final[dict[type[Any], Mapping[str, Column]]] = {}


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(column, field))
class _Declared:
    """Base whose subclasses become dataclasses.

    Type checkers treat batches as frozen. At run time they are not: the constructor of a frozen dataclass
    takes several times as long, which is much of the cost of a batch of one row.

    Raises:
        BatchError: if a field is no column.
    """

    def __init_subclass__(cls) -> None:
        for name, hint in get_annotations(cls).items():
            given = vars(cls).get(name)
            is_column = isinstance(given, Field) and "column" in given.metadata
            if _Declared not in cls.__bases__ and not is_column and "ClassVar" not in str(hint):
                reason = f"is not a column: write {name}: Reals = column(np.float64, unit=...)"
                raise BatchError(cls.__name__, name, reason)
        dataclass(eq=False)(cls)
        kind: Any = cls
        own = {each.name: each.metadata["column"] for each in fields(kind) if "column" in each.metadata}
        for base in cls.__mro__:
            own = {**_columns.get(base, {}), **own}
        _columns[cls] = MappingProxyType(own)


class Batch(_Declared):
    """Rows of one type, ordered by event time."""

    time: Times = column(np.int64, unit="ns")  # (n,) event time
    finger: int = field(default=EVERY, kw_only=True)  # fingertip of all rows

    def __len__(self) -> int:
        return len(self.time)

    @property
    def cells(self) -> int:
        """Number of cells of the fingertip; 0 if the type has no column per cell."""
        name = layout(type(self)).cell_column
        return int(getattr(self, name).shape[-1]) if name else 0

    def __getitem__(self, rows: slice | Flags | NDArray[np.intp]) -> Self:
        """Return rows by slice (as views), or by flags or indices (as copies)."""
        kind = type(self)
        return kind(*[column[rows] for column in layout(kind).take(self)], finger=self.finger)

    @classmethod
    def empty(cls) -> Self:
        """Return a batch without rows.

        >>> Touch.empty().counts.shape
        (0, 6)
        """
        empty: Self | None = _empty.get(cls)
        if empty is None:
            empty = _empty[cls] = cls.zeros(0)
        return empty

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
        expected = layout(type(self))
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
        return _is_ordered(self.time)

    def check_order(self) -> Self:
        """Return this batch if its time never decreases.

        Raises:
            BatchError: if it does.
        """
        if self.time.size > 1 and not self.is_ordered():
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
        self.cell_column = next((name for name, each in expected.items() if CELLS in each.shape), None)
        getter = attrgetter(*expected)
        self.take: Callable[[Batch], tuple[NDArray[Any], ...]] = (
            getter if len(expected) > 1 else lambda batch: (batch.time,)
        )


@row_loop
def _is_ordered(time: Times, /) -> bool:
    ordered = True
    for row in range(1, len(time)):
        ordered = ordered and time[row] >= time[row - 1]
    return bool(ordered)


_layouts: Final[dict[type[Any], Layout]] = {}
_empty: Final[dict[type[Any], Any]] = {}


def columns(kind: type[Batch]) -> Mapping[str, Column]:
    """Return the array columns of a batch type, in order.

    >>> list(columns(Motion))
    ['time', 'device_time', 'velocity', 'pose']
    """
    return _columns[kind]


def layout(kind: type[Batch]) -> Layout:
    """Return the layout of a batch type."""
    if kind not in _layouts:
        _layouts[kind] = Layout(kind)
    return _layouts[kind]


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


class Clocks(Batch):
    """Relation of a device's clock to the host's: host = device + offset + drift * (time since `time`)."""

    offset: Times = column(np.int64, unit="ns")  # (n,) host minus device, at `time`
    drift: Reals = column(np.float64, unit="s/s")  # (n,) change of the offset
    residual: Reals = column(np.float64, unit="s")  # (n,) mean lateness of the rows


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

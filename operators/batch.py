"""What flows: typed columnar batches of numpy arrays that share their first axis.

A batch of one row is the live case, a batch of a million the backfill: the same code takes both.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final, Self, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from operators.errors import BatchError

Times: TypeAlias = NDArray[np.int64]  # ns since 1970-01-01 UTC
Counts: TypeAlias = NDArray[np.int16]  # ADC counts of a barometer
Flags: TypeAlias = NDArray[np.bool_]
Codes: TypeAlias = NDArray[np.int8]
Reals: TypeAlias = NDArray[np.float64]

BAROMETERS: Final = 6  # cells of one fingertip: 5 4 3 over 0 1 2, x right, y up
EVERY: Final = -1  # finger of a batch that belongs to all fingertips alike, as the arm's motion does
SLIP: Final = 1
STATIC: Final = 0
UNKNOWN: Final = -1
MOTIONS: Final = ("translation", "rotation", "hold", "tap", "lift")
SURFACES: Final = ("plane", "sphere", "cylinder_x", "cylinder_y")
us: Final = 1_000  # ns
ms: Final = 1_000_000  # ns
s: Final = 1_000_000_000  # ns


@dataclass(frozen=True)
class Column:
    """Element type, shape of one row (-1: any length) and unit of one field of a batch."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    unit: str
    names: tuple[str, ...] = ()  # of the codes 0, 1, ...: files store the names; empty: values are no codes


def column(
    dtype: DTypeLike, *shape: int, unit: str = "", names: tuple[str, ...] = ()
) -> Mapping[str, Column]:
    """Return the metadata of a batch field; checks, empty batches and Arrow schemas are derived from it."""
    return MappingProxyType({"column": Column(np.dtype(dtype), shape, unit, names)})


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Rows of one kind in the order of their event time."""

    time: Times = field(metadata=column(np.int64, unit="ns"))  # (n,) event time
    finger: int = field(default=EVERY, kw_only=True)  # the fingertip that these rows belong to

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: slice | Flags | NDArray[np.intp]) -> Self:
        """Rows by slice (a view), by flags or by indices (a copy)."""
        kind = type(self)
        return kind(*[column[rows] for column in layout(kind).take(self)], finger=self.finger)

    @classmethod
    def empty(cls) -> Self:
        """A batch of no rows.

        >>> Touch.empty().counts.shape
        (0, 6)
        """
        empty: Self | None = _empty.get(cls)
        if empty is None:
            shapes = [(c.dtype, (0, *(max(size, 0) for size in c.shape))) for c in columns(cls).values()]
            empty = _empty[cls] = cls(*(np.empty(shape, dtype) for dtype, shape in shapes))
        return empty

    def check(self) -> Self:
        """Return this batch, or raise if a column has the wrong type or shape.

        Raises:
            BatchError: naming the column.
        """
        expected, rows = layout(type(self)), len(self.time)
        shapes = expected.single if rows == 1 else [(rows, *shape) for shape in expected.shapes]
        for value, dtype, shape in zip(expected.take(self), expected.dtypes, shapes, strict=True):
            if type(value) is not np.ndarray or value.dtype is not dtype or value.shape != shape:
                return self._check_each()
        return self

    def _check_each(self) -> Self:
        """Look closer, and say what is wrong."""
        kind, length = type(self).__name__, len(self.time)
        for name, expected in columns(type(self)).items():
            value: NDArray[Any] = getattr(self, name)
            found = getattr(value, "dtype", type(value).__name__)
            if found != expected.dtype:
                raise BatchError(kind, name, f"is {found}, must be an array of {expected.dtype}")
            shape = value.shape
            if (
                len(shape) != 1 + len(expected.shape)
                or shape[0] != length
                or any(want not in (-1, have) for want, have in zip(expected.shape, shape[1:], strict=True))
            ):
                want = ", ".join(str(size) if size >= 0 else "any" for size in (length, *expected.shape))
                raise BatchError(kind, name, f"has shape {shape}, must be ({want})")
        return self


AnyBatch = TypeVar("AnyBatch", bound=Batch)


class Layout:
    """The columns of a batch type, at hand for what is done with each batch."""

    def __init__(self, kind: type[Batch]) -> None:
        expected = columns(kind)
        self.dtypes = [each.dtype for each in expected.values()]
        self.shapes = [each.shape for each in expected.values()]  # of a row
        self.single = [(1, *shape) for shape in self.shapes]  # of a batch of one row
        getter = attrgetter(*expected)
        self.take: Callable[[Batch], tuple[NDArray[Any], ...]] = (
            getter if len(expected) > 1 else lambda batch: (batch.time,)
        )


_layouts: Final[dict[type[Any], Layout]] = {}
_columns: Final[dict[type[Any], Mapping[str, Column]]] = {}
_empty: Final[dict[type[Any], Any]] = {}


def columns(kind: type[Batch]) -> Mapping[str, Column]:
    """The array columns of a batch type, in order.

    >>> list(columns(Motion))
    ['time', 'device_time', 'velocity', 'pose']
    """
    if kind not in _columns:
        _columns[kind] = MappingProxyType(
            {f.name: f.metadata["column"] for f in fields(kind) if "column" in f.metadata}
        )
    return _columns[kind]


def layout(kind: type[Batch]) -> Layout:
    """The layout of a batch type."""
    found = _layouts.get(kind)
    if found is None:
        found = _layouts[kind] = Layout(kind)
    return found


def maker(kind: type[AnyBatch]) -> Callable[..., AnyBatch]:
    """A function of a type's columns and the fingertip, in order, that makes a batch in half the usual time.

    It is written out as dataclasses write a constructor, but sets the slots themselves: where a row is a
    batch, much of what an operator costs is the making of its output.

    >>> maker(Scores)(np.array([3]), np.array([0.5]), 7)
    Scores(time=array([3]), finger=7, probability=array([0.5]))
    """
    names = [*columns(kind), "finger"]
    scope: dict[str, Any] = {f"set_{name}": getattr(kind, name).__set__ for name in names}
    scope |= {"kind": kind, "new": object.__new__}
    lines = [f"def make({', '.join(names)}):", "batch = new(kind)"]
    lines += [f"set_{name}(batch, {name})" for name in names]
    exec("\n    ".join([*lines, "return batch"]), scope)  # noqa: S102 - the names are our own fields'
    make: Callable[..., AnyBatch] = scope["make"]
    return make


def concat(kind: type[AnyBatch], batches: Sequence[AnyBatch]) -> AnyBatch:
    """One batch of the rows of several, which belong to one fingertip; empty ones fall away.

    Raises:
        BatchError: if they are of several fingertips.
    """
    full = [batch for batch in batches if batch.time.size]
    if len(full) == 1:
        return full[0]
    if not full:
        return kind.empty()
    if len({batch.finger for batch in full}) > 1:
        raise BatchError(kind.__name__, "finger", "batches of several fingertips cannot become one")
    parts = zip(*map(layout(kind).take, full), strict=True)  # of each column
    return kind(*map(np.concatenate, parts), finger=full[0].finger)


def constant(values: ArrayLike, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """An array that cannot be written to, so that many batches may share it."""
    array = np.array(values, dtype)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True, eq=False)
class Touch(Batch):
    """Readings of one fingertip's barometers, as received: raw counts fall as pressure rises."""

    counts: Counts = field(metadata=column(np.int16, BAROMETERS, unit="count"))  # (n, 6) raw ADC, 0..1023
    temperature: Counts = field(metadata=column(np.int16, BAROMETERS, unit="count"))  # (n, 6) raw ADC
    # (n, 6) False: the cell did not answer, or its answer cannot mean what it says
    valid: Flags = field(metadata=column(np.bool_, BAROMETERS))


@dataclass(frozen=True, slots=True, eq=False)
class Zeroed(Touch):
    """A touch whose counts are relative to the unloaded fingertip: negative means more pressure."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion(Batch):
    """Motion of the arm's tool centre point (TCP), in the robot's base frame."""

    device_time: Times = field(metadata=column(np.int64, unit="ns"))  # (n,) the controller's own stamp
    velocity: Reals = field(metadata=column(np.float64, 6, unit="m/s, rad/s"))  # (n, 6) linear, angular
    pose: Reals = field(metadata=column(np.float64, 6, unit="m, rad"))  # (n, 6) rotation vector; NaN unknown


@dataclass(frozen=True, slots=True, eq=False)
class Sample(Zeroed):
    """A zeroed touch with the arm's motion at its instant; unmatched rows have NaN motion."""

    velocity: Reals = field(metadata=column(np.float64, 6, unit="m/s, rad/s"))  # (n, 6) base frame
    pose: Reals = field(metadata=column(np.float64, 6, unit="m, rad"))  # (n, 6) base frame
    matched: Flags = field(metadata=column(np.bool_))  # (n,) False: no motion near enough in time


@dataclass(frozen=True, slots=True, eq=False)
class Labelled(Sample):
    """A sample with what the arm's motion says of it."""

    speed: Reals = field(metadata=column(np.float64, unit="m/s"))  # (n,) in the contact plane; NaN unknown
    label: Codes = field(metadata=column(np.int8, unit="1 slip, 0 static, -1 unknown"))  # (n,)


@dataclass(frozen=True, slots=True, eq=False)
class Windows(Batch):
    """The samples up to each instant, newest last, as a view into one buffer: do not write to it."""

    counts: Counts = field(metadata=column(np.int16, -1, BAROMETERS, unit="count"))  # (n, length, 6)
    valid: Flags = field(metadata=column(np.bool_, -1, BAROMETERS))  # (n, length, 6)


@dataclass(frozen=True, slots=True, eq=False)
class Scores(Batch):
    """How sure a detector is of slip at each instant."""

    probability: Reals = field(metadata=column(np.float64))  # (n,) 0..1; NaN where it cannot tell


@dataclass(frozen=True, slots=True, eq=False)
class Slips(Batch):
    """Slip events: one row at each onset and at each end."""

    state: Codes = field(metadata=column(np.int8, unit="1 onset, 0 end"))  # (n,)
    start: Times = field(metadata=column(np.int64, unit="ns"))  # (n,) first sample of the run that decided
    probability: Reals = field(metadata=column(np.float64))  # (n,) at `time`, the sample that decided


@dataclass(frozen=True, slots=True, eq=False)
class Faults(Batch):
    """Changes in the health of single barometers."""

    barometer: Codes = field(metadata=column(np.int8))  # (n,) 0..5
    kind: Codes = field(metadata=column(np.int8))  # (n,) a FaultKind
    active: Flags = field(metadata=column(np.bool_))  # (n,) True: it begins, False: it ends


@dataclass(frozen=True, slots=True, eq=False)
class Commands(Batch):
    """What the hand is to do from `time` on; a NaN row of either leaves it as it was."""

    force: Reals = field(metadata=column(np.float64, unit="N"))  # (n,) normal, at least 0
    velocity: Reals = field(metadata=column(np.float64, 6, unit="m/s, rad/s"))  # (n, 6) TCP, base frame


@dataclass(frozen=True, slots=True, eq=False)
class Clocks(Batch):
    """How a device's clock stood to the host's: host = device + offset + drift * (time gone by since)."""

    offset: Times = field(metadata=column(np.int64, unit="ns"))  # (n,) host minus device, at `time`
    drift: Reals = field(metadata=column(np.float64, unit="s/s"))  # (n,) what the offset gains
    residual: Reals = field(metadata=column(np.float64, unit="s"))  # (n,) by which rows came late, mean


@dataclass(frozen=True, slots=True, eq=False)
class Episodes(Batch):
    """Motions of the arm, such as one stroke over a surface; `time` is the start."""

    end: Times = field(metadata=column(np.int64, unit="ns"))  # (n,) first instant after it
    motion: Codes = field(metadata=column(np.int8, names=MOTIONS))  # (n,)
    surface: Codes = field(metadata=column(np.int8, names=SURFACES))  # (n,)
    # (n,) of a translation or tap, in the fingertip's plane, anticlockwise from x
    direction: Reals = field(metadata=column(np.float64, unit="rad"))
    speed: Reals = field(metadata=column(np.float64, unit="m/s"))  # (n,) along the direction
    angular_speed: Reals = field(metadata=column(np.float64, unit="rad/s"))  # (n,) anticlockwise
    depth: Reals = field(metadata=column(np.float64, unit="m"))  # (n,) beyond first contact; NaN unknown
    force: Reals = field(metadata=column(np.float64, unit="N"))  # (n,) normal, at the start; NaN unknown


@dataclass(frozen=True, slots=True, eq=False)
class Truth(Batch):
    """State of the simulated contact at the true instant of each touch sample, for tests and evaluation."""

    # (n,) mean over the pad since the last row
    sliding: Reals = field(metadata=column(np.float64, unit="m/s"))
    force: Reals = field(metadata=column(np.float64, unit="N"))  # (n,) normal
    # (n, 3) arm at the pad's centre, with its vibration: x, y, about the normal
    velocity: Reals = field(metadata=column(np.float64, 3, unit="m/s, rad/s"))


ANNOTATIONS: Final[tuple[type[Batch], ...]] = (Episodes, Truth)  # streams that a recording may lack

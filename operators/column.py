"""Declaration of the columns of a batch type."""

from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from inspect import get_annotations
from types import MappingProxyType
from typing import Any, Final, cast, dataclass_transform

import numpy as np
from numpy.typing import DTypeLike, NDArray

from operators.errors import BatchError

CELLS: Final = -2  # size of a column: the number of cells, the same in all columns of a batch


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

    >>> from operators.batch import Batch, Reals
    >>> class Force(Batch):
    ...     normal: Reals = column(np.float64, unit="N")  # (n,)
    >>> Force.zeros(rows=2).normal
    array([0., 0.])
    """
    return field(metadata={"column": Column(np.dtype(dtype), shape, unit, names)})


declared: Final[dict[type[Any], Mapping[str, Column]]] = {}


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(column, field))
class Declared:
    """Base whose subclasses become dataclasses.

    Type checkers treat batches as frozen. At run time they are not: the constructor of a frozen dataclass
    takes several times as long, which is much of the cost of a batch of one row.

    Raises:
        BatchError: if a field is no column, or its name has a meaning in batches or rows.
    """

    def __init_subclass__(cls) -> None:
        for name, hint in get_annotations(cls).items():
            given = vars(cls).get(name)
            is_column = isinstance(given, Field) and "column" in given.metadata
            if Declared not in cls.__bases__ and not is_column and "ClassVar" not in str(hint):
                reason = f"is not a column: write {name}: Reals = column(np.float64, unit=...)"
                raise BatchError(cls.__name__, name, reason)
            taken = any(hasattr(base, name) or name in declared.get(base, ()) for base in cls.__bases__)
            if is_column and (taken or hasattr(np.record, name)):
                reason = "is a name that batches or rows of numpy use: choose another one"
                raise BatchError(cls.__name__, name, reason)
        dataclass(eq=False)(cls)
        kind: Any = cls
        own = {each.name: each.metadata["column"] for each in fields(kind) if "column" in each.metadata}
        for base in cls.__mro__:
            own = {**declared.get(base, {}), **own}
        declared[cls] = MappingProxyType(own)
        for name in own:
            setattr(cls, name, _Unpacked(name))


class _Unpacked:
    """Attribute of a batch that is made from the packed rows when it is first read: one column."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, batch: object, kind: type[Any]) -> NDArray[Any]:
        """Return the column; it hides this attribute from then on."""
        name = self._name
        if "packed" not in getattr(batch, "__dict__", ()):  # of the class, or of a batch without this column
            raise AttributeError(name)
        packed = cast("Any", batch).packed
        if name not in (packed.dtype.names or ()):
            raise BatchError(kind.__name__, name, f"is missing in packed rows of {packed.dtype.names}")
        values: NDArray[Any] = packed[name]
        if declared[kind][name].dtype == np.bool_:
            values = values.view(np.bool_)
        vars(batch)[name] = values
        return values

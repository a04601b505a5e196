"""Batches as Arrow tables and back: arrays are FixedSizeList columns, units stand in the field metadata."""

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from operators.batch import EVERY, Batch, Column, columns
from storage.episodes import Numbering
from storage.layout import SAMPLES, TABLE_OF, Table
from storage.parts import flat

_KINDS: Final = {kind.__name__: kind for kind in TABLE_OF}


def schema(table: Table, kind: type[Batch] | None = None) -> pa.Schema:
    """The Arrow schema of a table; its metadata "batch" names the type of the batches that it was made of.

    >>> from storage.layout import TOUCH
    >>> schema(TOUCH).field("counts").type
    FixedSizeListType(fixed_size_list<item: int16>[6])
    """
    return pa.schema(_fields(table), {"batch": (kind or table.kind).__name__})


def holders(table: Table) -> pa.Schema:
    """As much of a table's schema as tells whose its rows are: the fingertip, or else the time.

    >>> from storage.layout import MOTION, TOUCH
    >>> holders(TOUCH).names, holders(MOTION).names
    (['finger'], ['time'])
    """
    name = "finger" if table.finger else "time"
    return pa.schema([field for field in _fields(table) if field.name == name])


def to_arrow(table: Table, batches: Sequence[Batch], episodes: Numbering) -> pa.Table:
    """The rows of one or more batches of one type, in the order given; `episodes` numbers the samples'."""
    values: dict[str, NDArray[Any]] = {
        name: np.concatenate([getattr(batch, name) for batch in batches]) for name in table.columns
    }
    fingers = np.array([batch.finger for batch in batches], np.int16)
    values["finger"] = np.repeat(fingers, [len(batch) for batch in batches])
    if table is SAMPLES:
        values["episode"] = episodes.at(values["time"])
    target = schema(table, type(batches[0]))
    return pa.Table.from_arrays([_array(values[name]) for name in target.names], schema=target)


def batch_type(rows: pa.Table) -> type[Batch] | None:
    """The type of the batches that a table was made of, None where its metadata do not say."""
    return _KINDS.get((rows.schema.metadata or {}).get(b"batch", b"").decode(errors="replace"))


def fingers(table: Table, rows: pa.Table) -> frozenset[int]:
    """The fingertips that have rows, of which the columns of `holders` are enough."""
    if not table.finger:
        return frozenset({EVERY} if len(rows) else ())
    found: list[int] = np.unique(_values(rows, "finger")).tolist()
    return frozenset(found)


def from_arrow(table: Table, kind: type[Batch], rows: pa.Table) -> dict[int, Batch]:
    """The rows as batches of `kind`, by fingertip.

    What samples do not keep comes back as unknown: the temperature as -1, the pose as NaN, `matched` as
    whether there is a velocity.
    """
    values: dict[str, NDArray[Any]] = {}
    for name, each in columns(kind).items():
        if name in table.columns:
            values[name] = _values(rows, name).reshape(-1, *each.shape)
        elif name == "matched":
            values[name] = np.logical_not(np.isnan(values["velocity"]).all(axis=1))
        else:
            unknown = np.nan if each.dtype.kind == "f" else -1
            values[name] = np.full((len(rows), *each.shape), unknown, each.dtype)
    found = fingers(table, rows)
    if len(found) <= 1:
        return {each: kind(*values.values(), finger=each) for each in found}
    finger = _values(rows, "finger")  # (n,)
    order = finger.argsort(kind="stable")  # a fingertip's rows side by side, in their order
    first = finger[order].searchsorted(sorted(found))  # (fingers,)
    return {
        each: kind(*(value[own] for value in values.values()), finger=each)
        for each, own in zip(sorted(found), np.split(order, first[1:]), strict=True)
    }


def _fields(table: Table) -> "list[pa.Field[Any]]":
    fields = [_field(name, each) for name, each in table.columns.items()]
    if table.finger:
        fields.insert(1, pa.field("finger", pa.int16(), nullable=False))
    if table is SAMPLES:
        fields.append(pa.field("episode", pa.int32(), nullable=False))
    return fields


def _field(name: str, column: Column) -> "pa.Field[Any]":
    element = pa.from_numpy_dtype(column.dtype)
    kind = pa.list_(element, *column.shape) if column.shape else element
    return pa.field(name, kind, nullable=False, metadata={"unit": column.unit} if column.unit else None)


def _array(values: NDArray[Any]) -> "pa.Array[Any]":
    array: pa.Array[Any] = pa.array(values.reshape(-1))
    if values.ndim > 1:
        array = cast("Any", pa.FixedSizeListArray).from_arrays(array, values.shape[1])
    return array


def _values(rows: pa.Table, name: str) -> NDArray[Any]:
    return flat(rows[name]).to_numpy(zero_copy_only=False)

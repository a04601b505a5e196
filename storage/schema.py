"""Conversion of batches to Arrow tables and back.

Arrays become FixedSizeLists, codes with names become dictionaries of strings. Units are in the metadata of
the fields.
"""

from __future__ import annotations  # they name classes of pyarrow

from collections.abc import Sequence
from functools import cache
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, CELLS, EVERY, Batch, Column, columns
from operators.errors import BatchError
from storage.arrow import pa
from storage.layout import TABLE_OF, TABLES, Table

_KINDS: Final = {kind.__name__: kind for kind in TABLE_OF}
_PER_CELL: Final = {name for table in TABLES for name, each in table.columns.items() if CELLS in each.shape}


def schema(table: Table, kind: type[Batch] | None = None, cells: int = BAROMETERS) -> pa.Schema:
    """Return the Arrow schema of a table; its metadata "batch" has the type of its batches.

    >>> from storage.layout import TOUCH
    >>> schema(TOUCH).field("counts").type
    FixedSizeListType(fixed_size_list<item: int16>[6])
    """
    return _schema(table, (kind or table.kind).__name__, cells)


def fitted(expected: pa.Schema, found: pa.Schema) -> pa.Schema:
    """Return an expected schema with as many cells as a file has."""
    kept = fields_of(expected)
    for field in fields_of(found):
        if field.name in _PER_CELL and pa.types.is_fixed_size_list(field.type):
            kept = [_resized(each, int(field.type.list_size)) for each in kept]
            break
    return pa.schema(kept, cast("Any", expected.metadata))


def to_arrow(table: Table, batches: Sequence[Batch]) -> pa.Table:
    """Return the rows of one or more batches of one type, in the order given."""
    values: dict[str, NDArray[Any]] = {
        name: np.concatenate([getattr(batch, name) for batch in batches]) for name in table.columns
    }
    fingers = np.array([batch.finger for batch in batches], np.int16)
    values["finger"] = np.repeat(fingers, [len(batch) for batch in batches])
    target, kept = schema(table, type(batches[0]), batches[0].cells), table.columns
    arrays = [_array(values[name], kept[name].names if name in kept else ()) for name in target.names]
    return pa.Table.from_arrays(arrays, schema=target)


def batch_type(rows: pa.Table) -> type[Batch] | None:
    """Return the type of the batches of a table, None if its metadata lacks it."""
    return _KINDS.get((rows.schema.metadata or {}).get(b"batch", b"").decode(errors="replace"))


def from_arrow(table: Table, kind: type[Batch], rows: pa.Table) -> dict[int, Batch]:
    """Return the rows as batches of `kind`, by fingertip.

    Columns that samples do not store are unknown: temperature -1, others NaN, `matched` true if there is a
    velocity.

    Raises:
        BatchError: if a name has no code.
    """
    values: dict[str, NDArray[Any]] = {}
    cells = next((_width(rows, name) for name in table.columns if name in _PER_CELL), 0)
    for name, each in columns(kind).items():
        if name in table.columns:
            if each.names:
                values[name] = _codes(kind, name, each.names, rows)
            else:
                values[name] = _values(rows, name).reshape(len(rows), *each.sizes(cells))
        elif name == "matched":
            values[name] = np.logical_not(np.isnan(values["velocity"]).all(axis=1))
        else:
            unknown = np.nan if each.dtype.kind == "f" else -1
            values[name] = np.full((len(rows), *each.sizes(cells)), unknown, each.dtype)
    finger = _values(rows, "finger") if table.finger else np.full(len(rows), EVERY)  # (n,)
    found: list[int] = np.unique(finger).tolist()
    if len(found) <= 1:
        return {each: kind(*values.values(), finger=each) for each in found}
    order = finger.argsort(kind="stable")  # groups the rows by fingertip, in order
    first = finger[order].searchsorted(found)  # (fingers,)
    return {
        each: kind(*(value[own] for value in values.values()), finger=each)
        for each, own in zip(found, np.split(order, first[1:]), strict=True)
    }


def fields_of(schema: pa.Schema) -> list[pa.Field[Any]]:
    """Return the fields of a schema."""
    return list(schema)


def flat(column: pa.ChunkedArray[Any]) -> pa.Array[Any]:
    """Return the values of a column in one array; FixedSizeLists are flattened."""
    array: Any = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()  # which copies
    values: pa.Array[Any] = array.flatten() if pa.types.is_fixed_size_list(array.type) else array
    return values


@cache
def _schema(table: Table, batch: str, cells: int) -> pa.Schema:
    return pa.schema(_fields(table, cells), {"batch": batch})


def _fields(table: Table, cells: int) -> list[pa.Field[Any]]:
    fields = [_field(name, each, cells) for name, each in table.columns.items()]
    if table.finger:
        fields.insert(1, pa.field("finger", pa.int16(), nullable=False))
    return fields


def _field(name: str, column: Column, cells: int) -> pa.Field[Any]:
    element: pa.DataType = pa.from_numpy_dtype(column.dtype)
    if column.names:
        element = pa.dictionary(cast("Any", element), pa.string())
    kind = pa.list_(element, *column.sizes(cells)) if column.shape else element
    return pa.field(name, kind, nullable=False, metadata={"unit": column.unit} if column.unit else None)


def _resized(field: pa.Field[Any], cells: int) -> pa.Field[Any]:
    """Return a field; if it has one value per cell, with another number of cells."""
    return field.with_type(pa.list_(field.type.value_type, cells)) if field.name in _PER_CELL else field


def _width(rows: pa.Table, name: str) -> int:
    return int(cast("Any", rows).schema.field(name).type.list_size)


def _array(values: NDArray[Any], names: Sequence[str]) -> pa.Array[Any]:
    array: pa.Array[Any] = pa.array(values.reshape(-1))
    if names:
        array = cast("Any", pa.DictionaryArray).from_arrays(array, pa.array(names))
    if values.ndim > 1:
        array = cast("Any", pa.FixedSizeListArray).from_arrays(array, values.shape[1])
    return array


def _values(rows: pa.Table, name: str) -> NDArray[Any]:
    return flat(rows[name]).to_numpy(zero_copy_only=False)


def _codes(kind: type[Batch], column: str, names: tuple[str, ...], rows: pa.Table) -> NDArray[Any]:
    """Return the codes (n,) of a column that is stored by name.

    Raises:
        BatchError: if a name has no code.
    """
    array: Any = flat(rows[column])
    stored: list[str] = array.dictionary.to_pylist()
    if unknown := set(stored) - set(names):
        reason = f"holds {', '.join(map(repr, sorted(unknown)))}, must be one of {', '.join(names)}"
        raise BatchError(kind.__name__, column, reason)
    code = np.array([names.index(each) for each in stored], columns(kind)[column].dtype)
    codes: NDArray[Any] = code[array.indices.to_numpy()]
    return codes

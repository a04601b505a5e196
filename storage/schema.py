"""Conversion of batches to Arrow tables and back.

Arrays become FixedSizeLists, codes with names become dictionaries of strings. Units are in the metadata of
the fields.
"""

from __future__ import annotations  # they name classes of pyarrow

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, EVERY, Batch, columns
from operators.column import CELLS
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
    fields = list[Any]()
    for name, column in table.columns.items():
        element: pa.DataType = pa.from_numpy_dtype(column.dtype)
        if column.names:
            element = pa.dictionary(cast("Any", element), pa.string())
        of_row = pa.list_(element, *column.sizes(cells)) if column.shape else element
        unit = {"unit": column.unit} if column.unit else None
        fields.append(pa.field(name, of_row, nullable=False, metadata=unit))
    if table.finger:
        fields.insert(1, pa.field("finger", pa.int16(), nullable=False))
    return pa.schema(fields, {"batch": (kind or table.kind).__name__})


def cells_of(found: pa.Schema) -> int:
    """Return the number of cells of the fingertip in a file; of a TakkTile if it has no column per cell."""
    kinds = (field.type for field in found if field.name in _PER_CELL)
    return next((int(kind.list_size) for kind in kinds if pa.types.is_fixed_size_list(kind)), BAROMETERS)


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
    cells = cells_of(rows.schema)
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


def flat(column: pa.ChunkedArray[Any]) -> pa.Array[Any]:
    """Return the values of a column in one array; FixedSizeLists are flattened."""
    array: Any = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()  # which copies
    values: pa.Array[Any] = array.flatten() if pa.types.is_fixed_size_list(array.type) else array
    return values


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
    """Return the codes (n,) of a column that is stored by name."""
    stored: list[Any] = cast("Any", rows)[column].to_pylist()
    if unknown := set(stored) - set(names):
        reason = f"holds {', '.join(map(repr, sorted(unknown)))}, must be one of {', '.join(names)}"
        raise BatchError(kind.__name__, column, reason)
    return np.array([names.index(each) for each in stored], columns(kind)[column].dtype)

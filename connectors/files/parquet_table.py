"""Reader of Parquet files; declared sizes are checked before anything is unpacked."""

import hashlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import polars as pl

from connectors.files import trace_table
from connectors.files.csv_table import read_bytes
from connectors.files.trace_table import TraceTable
from operators.errors import InputError
from storage.parquet_pages import declared_sizes

VALUE_SIZE: Final = 8  # bytes of an unpacked value


def read_parquet(path: Path) -> TraceTable:
    """Read a Parquet file; lists become columns ``name0``, ``name1``, ..., structs ``name.field``.

    Raises:
        InputError: if it cannot be read, is damaged or too large.
    """
    where, content = str(path), read_bytes(path)
    try:
        _, unpacked, values = declared_sizes(content)
        if max(unpacked, values * VALUE_SIZE) > trace_table.LIMIT:
            raise InputError(
                where, f"unpacks to more than {trace_table.LIMIT >> 20} MiB; cut it into several traces"
            )
        frame = pl.read_parquet(io.BytesIO(content))
    except (ValueError, OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(where, f"is damaged or not a Parquet file: {reason:.200}; restore a copy") from None
    columns, left_out = dict[str, pl.Series](), dict[str, str]()
    for column in frame.get_columns():
        for name, values_of in _flat(column.name, column):
            if reason := _unusable(values_of):
                left_out[name] = reason
            else:
                columns[name] = values_of
    if not columns:
        raise InputError(where, "has no columns of numbers or texts")
    return TraceTable(columns, where, sha256=hashlib.sha256(content).hexdigest(), left_out=left_out)


def _flat(name: str, column: pl.Series) -> Iterator[tuple[str, pl.Series]]:
    """Yield the scalar columns of a column, and what cannot be split into them."""
    if isinstance(column.dtype, pl.Struct):
        for each in column.struct.fields:
            yield from _flat(f"{name}.{each}", column.struct.field(each))
        return
    if isinstance(column.dtype, pl.Array):
        column = column.arr.to_list()
    sizes = column.list.len().unique().drop_nulls() if isinstance(column.dtype, pl.List) else pl.Series([])
    if len(sizes) == 1 and sizes.item() * len(column) * VALUE_SIZE <= trace_table.LIMIT:
        for item in range(sizes.item()):
            yield from _flat(f"{name}{item}", column.list.get(item))
    else:
        yield name, column


def _unusable(column: pl.Series) -> str:
    """Return why a column cannot be used; empty: it can."""
    kind = column.dtype
    if kind == pl.String and (column.str.len_bytes().sum() or 0) > trace_table.LIMIT:
        return f"its texts have more than {trace_table.LIMIT >> 20} MiB"
    if isinstance(kind, pl.List):
        return "its lists differ in length"
    return f"its values are {kind}" if isinstance(kind, pl.Object | pl.Binary) else ""

"""Reader of Parquet files; declared sizes are checked before anything is unpacked."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import polars as pl

from connectors.files import trace_table
from connectors.files.csv_table import read_bytes
from connectors.files.trace_table import VALUE_SIZE, TraceTable
from operators.errors import InputError
from storage.arrow import pa, pq
from storage.parquet_pages import declared_sizes


def read_parquet(path: Path) -> TraceTable:
    """Read a Parquet file; lists become columns ``name0``, ``name1``, ..., structs ``name.field``.

    Raises:
        InputError: if it cannot be read, is damaged or too large.
    """
    where, content = str(path), read_bytes(path)
    try:
        rows, unpacked, values = declared_sizes(content)
        trace_table.check_size(where, max(unpacked, values * VALUE_SIZE), rows)
        names, series, left_out = _columns(content)
    except (ValueError, OSError, pa.ArrowException, pl.exceptions.PolarsError) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(where, f"is damaged or not a Parquet file: {reason:.200}; restore a copy") from None
    columns = dict[str, pl.Series]()
    for column in series:
        for name, values_of in _flat(column.name, column):
            if reason := _unusable(values_of):
                left_out[name] = reason
            else:
                columns.setdefault(name, values_of)
    if not columns:
        raise InputError(where, "has no columns of numbers or texts")
    names = [name for name in names if name in columns] + [name for name in columns if name not in names]
    sha256 = hashlib.sha256(content).hexdigest()
    return TraceTable(columns, where, names=names, sha256=sha256, left_out=left_out)


def _columns(content: bytes) -> tuple[list[str], list[pl.Series], dict[str, str]]:
    """Return the names in a file, its columns, and the reasons for those that are left out."""
    data = pa.BufferReader(content)
    schema: Any = pq.ParquetFile(data).schema_arrow
    texts = [field.name for field in schema if _is_text(field.type)]
    left_out = {field.name: f"its values are {field.type}" for field in schema if not _supported(field.type)}
    file: Any = pq.ParquetFile(data, read_dictionary=texts, page_checksum_verification=True)
    # without Arrow's threads: one that releases `data` last aborts a process that is exiting
    table: Any = file.read(use_threads=False)
    table.validate(full=True)
    pairs = zip(table.column_names, table.columns, strict=True)
    series = [pl.Series(name, column) for name, column in pairs if name not in left_out]
    return list(table.column_names), series, left_out


def _is_text(kind: Any) -> bool:  # noqa: ANN401 - a type of Arrow
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _supported(kind: Any) -> bool:  # noqa: ANN401 - a type of Arrow
    """Return True for numbers, texts and times, and for structs and lists of them."""
    types, structure = pa.types, kind
    if types.is_struct(kind):
        return all(_supported(structure.field(number).type) for number in range(structure.num_fields))
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return _supported(kind.value_type)
    if types.is_dictionary(kind):
        return _is_text(kind.value_type)
    number = types.is_integer(kind) or types.is_float32(kind) or types.is_float64(kind)
    time = types.is_timestamp(kind) or types.is_date(kind) or types.is_duration(kind)
    return bool(number or time or _is_text(kind) or types.is_boolean(kind) or types.is_decimal128(kind))


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
    if isinstance(kind, pl.List):
        return "its lists differ in length"
    longest = 0
    if isinstance(kind, pl.Categorical | pl.String):
        longest = cast("int", column.unique().cast(pl.String).str.len_bytes().max() or 0)
    large = longest * len(column) > trace_table.LIMIT
    return f"its texts have more than {trace_table.LIMIT >> 20} MiB" if large else ""

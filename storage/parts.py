"""Parquet files of a session: written atomically, verified when read."""

import hashlib
from pathlib import Path
from typing import Any, cast

import pyarrow as pa
import pyarrow.parquet as pq

from operators.errors import InputError
from storage import files
from storage.layout import inside
from storage.manifest import Part


def write_part(path: Path, table: pa.Table, put: files.Put = files.put) -> str:
    """Write a table as one Parquet file and return its sha256.

    Raises:
        OSError: if it cannot be written; the file is then missing or complete.
    """
    sink = pa.BufferOutputStream()
    cast("Any", pq).write_table(
        table,
        sink,
        compression="zstd",
        use_dictionary=False,
        column_encoding=_encodings(table.schema),
        write_page_checksum=True,
    )
    data = sink.getvalue().to_pybytes()
    put(path, data)
    return hashlib.sha256(data).hexdigest()


def commit_part(
    folder: Path,
    path: str,
    table: pa.Table,
    put: files.Put = files.put,
) -> Part:
    """Write a table as a file of a session and return its manifest entry.

    Args:
        folder: Folder of the session.
        path: Path within it.
        table: The rows.
        put: Function that writes the file.

    Raises:
        OSError: if it cannot be written; the file is then missing or complete.
        InputError: if a link leads out of the session.
    """
    return manifest_entry(path, table, write_part(inside(folder, folder / path), table, put))


def manifest_entry(path: str, table: pa.Table, sha256: str) -> Part:
    """Return the manifest entry of a file with these rows."""
    if not len(table):
        return Part(path, 0, 0, 0, sha256)
    time = table["time"].to_numpy()
    return Part(path, len(table), int(time.min()), int(time.max()), sha256)


def hash_part(path: Path) -> str:
    """Return the sha256 (hex) of a file.

    Raises:
        InputError: if it cannot be read.
    """
    return hashlib.sha256(files.read(path)).hexdigest()


def inspect_part(folder: Path, path: str, schema: pa.Schema) -> Part:
    """Read a file of a session and return its manifest entry.

    Raises:
        InputError: as `read_part`, or if a link leads out of the session.
    """
    file = inside(folder, folder / path)
    sha256 = hash_part(file)
    return manifest_entry(path, read_part(file, schema, sha256), sha256)


def read_part(path: Path, schema: pa.Schema, sha256: str | None = None) -> pa.Table:
    """Return the columns of `schema` from a Parquet file, which may have others.

    Args:
        path: The file.
        schema: Columns that it must have, with their types and units.
        sha256: Its sha256 in the manifest; None: not listed, so only the page checksums are verified.

    Raises:
        InputError: if the file is missing, damaged or lacks a column.
    """
    data = files.read(path)
    if sha256 and hashlib.sha256(data).hexdigest() != sha256:
        raise InputError(str(path), "is damaged: its sha256 differs from the manifest; restore a copy")
    try:
        file: Any = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        # without Arrow's threads: one that releases `data` last aborts a process that is exiting
        _check(path, file.schema_arrow, schema)
        table: pa.Table = file.read(schema.names, use_threads=False)
        table.validate(full=True)
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(str(path), f"is damaged or not a Parquet file: {reason}; restore a copy") from error
    if len(table) != file.metadata.num_rows:
        reason = f"is damaged: it has {len(table)} of its {file.metadata.num_rows} rows; restore a copy"
        raise InputError(str(path), reason)
    for field in _fields(schema):
        column = table[field.name]
        if not field.nullable and (column.null_count or flat(column).null_count):
            raise InputError(str(path), f"column {field.name!r} has nulls, must have none")
    return table


def flat(column: "pa.ChunkedArray[Any]") -> "pa.Array[Any]":
    """Return the values of a column in one array; FixedSizeLists are flattened."""
    array: Any = column.combine_chunks()
    values: pa.Array[Any] = array.flatten() if pa.types.is_fixed_size_list(array.type) else array
    return values


def _encodings(schema: pa.Schema) -> dict[str, str]:
    """Return the Parquet encoding of each column by its path in the file."""
    encodings: dict[str, str] = {}
    for field in _fields(schema):
        nested = pa.types.is_fixed_size_list(field.type)
        path = f"{field.name}.list.element" if nested else field.name
        kind = field.type.value_type if nested else field.type
        if pa.types.is_integer(kind):
            encodings[path] = "DELTA_BINARY_PACKED"
        elif pa.types.is_floating(kind):
            encodings[path] = "BYTE_STREAM_SPLIT"
    return encodings


def _check(path: Path, found: pa.Schema, expected: pa.Schema) -> None:
    columns = {field.name: field for field in _fields(found)}
    for field in _fields(expected):
        other = columns.get(field.name)
        if other is None:
            raise InputError(str(path), f"has no column {field.name!r}; it has {', '.join(columns)}")
        if other.type != field.type:
            raise InputError(str(path), f"column {field.name!r} is {other.type}, must be {field.type}")
        if _unit(other) != _unit(field):
            reason = f"column {field.name!r} is in {_unit(other)!r}, must be in {_unit(field)!r}"
            raise InputError(str(path), reason)


def _fields(schema: pa.Schema) -> "list[pa.Field[Any]]":
    return list(schema)


def _unit(field: "pa.Field[Any]") -> str:
    return (field.metadata or {}).get(b"unit", b"").decode(errors="replace")

"""One Parquet file: written whole or not at all, checked to the last bit when read."""

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
    """Commit a table as one Parquet file; give its sha256.

    Raises:
        OSError: the file is not there, or is whole.
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
    """Write a table as a file of the session in `folder`; give what the manifest is to say of it.

    Args:
        folder: The session's.
        path: Within it.
        table: The rows.
        put: How to write it.

    Raises:
        OSError: the file is not there, or is whole.
        InputError: if a link leads out of the session.
    """
    return described(path, table, write_part(inside(folder, folder / path), table, put))


def described(path: str, table: pa.Table, sha256: str) -> Part:
    """What the manifest says of a file that holds these rows."""
    if not len(table):
        return Part(path, 0, 0, 0, sha256)
    time = table["time"].to_numpy()
    return Part(path, len(table), int(time.min()), int(time.max()), sha256)


def hash_part(path: Path) -> str:
    """The sha256 of a file, hex.

    Raises:
        InputError: if it cannot be read.
    """
    return hashlib.sha256(files.read(path)).hexdigest()


def inspect_part(folder: Path, path: str, schema: pa.Schema) -> Part:
    """What a manifest would say of a file of the session in `folder`, which is read for it.

    Raises:
        InputError: as `read_part`, or if a link leads out of the session.
    """
    place = inside(folder, folder / path)
    sha256 = hash_part(place)
    return described(path, read_part(place, schema, sha256), sha256)


def read_part(path: Path, schema: pa.Schema, sha256: str | None = None) -> pa.Table:
    """The columns of `schema` from a Parquet file; it may have others.

    Args:
        path: The file.
        schema: The columns that it must have, with their types and units.
        sha256: What the manifest says of it; None where it is not listed: its pages still carry checksums.

    Raises:
        InputError: if the file is missing, damaged or lacks a column.
    """
    data = files.read(path)
    if sha256 and hashlib.sha256(data).hexdigest() != sha256:
        raise InputError(str(path), "is damaged: its sha256 is not the one in the manifest; put a copy back")
    try:
        file: Any = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        # in this thread: one of Arrow's own may be the last to let go of `data`, which aborts a process that
        # just ends
        _check(path, file.schema_arrow, schema)
        table: pa.Table = file.read(schema.names, use_threads=False)
        table.validate(full=True)
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(str(path), f"is damaged or no Parquet file: {reason}; put a copy back") from error
    if len(table) != file.metadata.num_rows:
        there = f"{len(table)} of its {file.metadata.num_rows} rows are there"
        raise InputError(str(path), f"is damaged: {there}; put a copy back")
    for field in _fields(schema):
        column = table[field.name]
        if not field.nullable and (column.null_count or flat(column).null_count):
            raise InputError(str(path), f"column {field.name!r} holds nulls, must hold none")
    return table


def flat(column: "pa.ChunkedArray[Any]") -> "pa.Array[Any]":
    """The values of a column in one array; those of FixedSizeLists, end to end."""
    array: Any = column.combine_chunks()
    values: pa.Array[Any] = array.flatten() if pa.types.is_fixed_size_list(array.type) else array
    return values


def _encodings(schema: pa.Schema) -> dict[str, str]:
    """How the columns are packed before they are compressed, by their path in the file."""
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

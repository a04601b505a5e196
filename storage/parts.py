"""Parquet files of a session: written atomically, verified when read."""

from __future__ import annotations  # they name classes of pyarrow

import hashlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, cast

from operators.errors import EndpointError, InputError
from storage import files
from storage.arrow import pa, pq
from storage.layout import Table
from storage.manifest import Part
from storage.parquet_pages import Sizes, declared_sizes
from storage.schema import fields_of, fitted, flat, schema

UNPACKED_LIMIT: Final = files.LIMIT  # bytes of the rows of one file


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
    """
    return manifest_entry(path, table, write_part(folder / path, table, put))


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


def inspect_part(folder: Path, path: str, table: Table) -> Part:
    """Read a file of a session and return its manifest entry.

    Raises:
        InputError: as `read_part`.
    """
    file = folder / path
    sha256 = hash_part(file)
    return manifest_entry(path, read_part(file, schema(table), sha256), sha256)


def read_part(
    path: Path, expected: pa.Schema, sha256: str | None = None, known: dict[str, Sizes] | None = None
) -> pa.Table:
    """Return the columns of a schema from a Parquet file, which may have others.

    Args:
        path: The file.
        expected: Columns that it must have, with their types and units.
        sha256: Its sha256 in the manifest; None: not listed, so only the page checksums are verified.
        known: Declared sizes of files by their sha256, for files that are read again; gets those of this one.

    Raises:
        InputError: if the file is missing, damaged, lacks a column or has more than `UNPACKED_LIMIT` bytes.
        EndpointError: if the disk fails or memory is short.
    """
    data = files.read(path)
    if sha256 and hashlib.sha256(data).hexdigest() != sha256:
        raise InputError(str(path), "is damaged: its sha256 differs from the manifest; restore a copy")
    try:
        file: Any = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        expected = fitted(expected, file.schema_arrow)
        _check_columns(path, file.schema_arrow, expected)
        sizes = (known or {}).get(sha256 or "") or declared_sizes(data)
        _check_size(path, sizes, expected)
        if sha256 and known is not None:
            known[sha256] = sizes
        # without Arrow's threads: one that releases `data` last aborts a process that is exiting
        table: pa.Table = file.read(expected.names, use_threads=False)
        table.validate(full=True)
    except MemoryError as error:
        raise EndpointError(str(path), files.NO_MEMORY) from error
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(str(path), f"is damaged or not a Parquet file: {reason}; restore a copy") from error
    if len(table) != file.metadata.num_rows:
        reason = f"is damaged: it has {len(table)} of its {file.metadata.num_rows} rows; restore a copy"
        raise InputError(str(path), reason)
    for field in fields_of(expected):
        column = table[field.name]
        if not field.nullable and (column.null_count or flat(column).null_count):
            raise InputError(str(path), f"column {field.name!r} has nulls, must have none")
    return table


def without_copies(folder: Path, paths: Iterable[str], listed: Mapping[str, Part]) -> list[str]:
    """Return the files of a table without unlisted copies of others; unreadable files are kept."""
    seen, found = {part.sha256 for part in listed.values()}, list[str]()
    for path in paths:
        if path not in listed:
            with suppress(InputError):  # reported when it is read
                sha256 = hash_part(folder / path)
                if sha256 in seen:
                    continue
                seen.add(sha256)
        found.append(path)
    return found


def _encodings(schema: pa.Schema) -> dict[str, str]:
    """Return the Parquet encoding of each column by its path in the file."""
    encodings: dict[str, str] = {}
    for field in fields_of(schema):
        nested = pa.types.is_fixed_size_list(field.type)
        path = f"{field.name}.list.element" if nested else field.name
        kind = field.type.value_type if nested else field.type
        if pa.types.is_integer(kind):
            encodings[path] = "DELTA_BINARY_PACKED"
        elif pa.types.is_floating(kind):
            encodings[path] = "BYTE_STREAM_SPLIT"
    return encodings


def _check_size(path: Path, sizes: Sizes, expected: pa.Schema) -> None:
    """Check the declared sizes before anything is unpacked.

    Raises:
        InputError: if rows or pages have too many bytes.
    """
    rows, unpacked, values = sizes
    row = sum(_row_size(field.type) for field in fields_of(expected))
    if max(unpacked, values, rows * row) > UNPACKED_LIMIT:
        reason = f"unpacks to more than {UNPACKED_LIMIT // files.MiB} MiB, the limit for such a file"
        raise InputError(str(path), reason)


def _row_size(kind: Any) -> int:  # noqa: ANN401 - a type with the attributes of its class
    """Return the size of a value in bytes."""
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size) * _row_size(kind.value_type)
    return 8 if pa.types.is_dictionary(kind) else -(-int(kind.bit_width) // 8)


def _check_columns(path: Path, found: pa.Schema, expected: pa.Schema) -> None:
    columns = {field.name: field for field in fields_of(found)}
    for field in fields_of(expected):
        other = columns.get(field.name)
        if other is None:
            raise InputError(str(path), f"has no column {field.name!r}; it has {', '.join(columns)}")
        if _with_any_index(other.type) != _with_any_index(field.type):
            raise InputError(str(path), f"column {field.name!r} is {other.type}, must be {field.type}")
        if _unit(other) != _unit(field):
            reason = f"column {field.name!r} is in {_unit(other)!r}, must be in {_unit(field)!r}"
            raise InputError(str(path), reason)


def _with_any_index(kind: Any) -> Any:  # noqa: ANN401 - a type with the attributes of its class
    """Return a type; if it is a dictionary, with one index type: pyarrow 16, Flink's, reads int32 for all."""
    return pa.dictionary(pa.int32(), kind.value_type) if pa.types.is_dictionary(kind) else kind


def _unit(field: pa.Field[Any]) -> str:
    return (field.metadata or {}).get(b"unit", b"").decode(errors="replace")

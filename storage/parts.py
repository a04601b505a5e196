"""Parquet files of a session, written atomically and verified when read, and the manifest that lists them."""

from __future__ import annotations  # they name classes of pyarrow

import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, cast

from operators.batch import packed_type, s
from operators.errors import EndpointError, InputError
from operators.ports import Description
from storage import files
from storage.arrow import pa, pq
from storage.description import UNKNOWN, check_identity, identity
from storage.layout import MANIFEST, TABLES, Table, file_name, may_exist, numbered_files, table_of
from storage.schema import cells_of, flat, schema

MANIFEST_VERSION: Final = 2
PART_SPAN: Final = 60 * s  # ns, longest event time span of a part
PART_ROWS: Final = 100_000  # most rows of a part
UNPACKED_LIMIT: Final = files.LIMIT  # bytes of the rows of one file

_FIX: Final = "restore a copy; each part is a Parquet file, which other programs read without it"
_SHA256: Final = re.compile("[0-9a-f]{64}")
_TIME_LIMIT: Final = 2**63  # ns; every time is below
_TYPES: Final = {"path": str, "rows": int, "first": int, "last": int, "sha256": str}


@dataclass(frozen=True)
class Part:
    """Entry of the manifest: one committed Parquet file."""

    path: str  # within the folder of the session
    rows: int
    first: int  # ns, earliest event time; 0 without rows
    last: int  # ns, latest event time; 0 without rows
    sha256: str  # hex

    @classmethod
    def of(cls, path: str, rows: pa.Table, sha256: str) -> Part:
        """Return the entry of a file with these rows."""
        if not len(rows):
            return cls(path, 0, 0, 0, sha256)
        time = rows["time"].to_numpy()
        return cls(path, len(rows), int(time.min()), int(time.max()), sha256)

    @cached_property
    def line(self) -> str:
        """Line of the manifest; cached, since a manifest is rewritten with every part."""
        return json.dumps(vars(self))  # `asdict` takes five times as long


def write_manifest(
    folder: Path, parts: Iterable[Part], about: Description = UNKNOWN, *, durable: bool = True
) -> None:
    """Replace the manifest of a session: its parts, a sha256 of the list, and the session in session.json.

    Raises:
        OSError: if it cannot be written; the old or the new manifest remains.
    """
    lines = ",\n".join(part.line for part in parts)
    head = json.dumps({"version": MANIFEST_VERSION, **identity(about)}).removesuffix("}")
    text = f'{head}, "parts": [\n{lines}\n], "sha256": "{_digest(lines)}"}}\n'
    files.put(folder / MANIFEST, text.encode(), durable=durable)


def read_manifest(folder: Path, about: Description = UNKNOWN) -> dict[str, Part]:
    """Return the parts in the manifest of a session by path.

    A recorder that was killed before it wrote the manifest has left no parts; then there are none.

    Raises:
        InputError: if the manifest is missing or damaged, or belongs to another session.
    """
    path = folder / MANIFEST
    if not may_exist(path) and not any(numbered_files(folder, table.pattern) for table in TABLES):
        return {}
    content = files.read_json(path, files.LIST_LIMIT)
    if content.get("version") != MANIFEST_VERSION or not isinstance(content.get("parts"), list):
        raise InputError(str(path), f'must have "version": {MANIFEST_VERSION} and a list "parts"; {_FIX}')
    check_identity(path, content, about)
    parts = [_part(f"{path}, part {number}", each) for number, each in enumerate(content["parts"])]
    listed = {part.path: part for part in parts}
    if len(listed) < len(parts):
        raise InputError(str(path), f"lists a part twice; {_FIX}")
    if content.get("sha256") != _digest(",\n".join(part.line for part in parts)):
        raise InputError(str(path), f"is damaged: its sha256 differs from that of its parts; {_FIX}")
    return listed


def write_part(folder: Path, path: str, rows: pa.Table, *, durable: bool = True) -> Part:
    """Write rows as a Parquet file of a session and return its manifest entry.

    Raises:
        OSError: if it cannot be written; the file is then missing or complete.
    """
    sink = pa.BufferOutputStream()
    cast("Any", pq).write_table(
        rows,
        sink,
        compression="zstd",
        use_dictionary=False,
        column_encoding=_encodings(rows.schema),
        write_page_checksum=True,
    )
    data = sink.getvalue().to_pybytes()
    files.put(folder / path, data, durable=durable)
    return Part.of(path, rows, hashlib.sha256(data).hexdigest())


def write_parts(
    folder: Path, table: Table, rows: pa.Table, *, number: int, limit: int, durable: bool = True
) -> list[Part]:
    """Write rows as files of a table, from a number on, each of at most `limit` rows; see `write_part`.

    A single-file table gets one file, also without rows.
    """
    size = limit if table.parted else max(len(rows), 1)
    if table.parted:
        files.make_folder(folder / table.name)
    starts = range(0, max(len(rows), 1), size)
    paths = [file_name(table.pattern, number + file) for file in range(len(starts))]
    return [
        write_part(folder, path, rows.slice(start, size), durable=durable)
        for path, start in zip(paths, starts, strict=True)
    ]


def read_part(folder: Path, part: Part) -> pa.Table:
    """Return the columns of a table from its Parquet file, which may have others.

    Raises:
        InputError: if the file is missing, damaged or not as listed, or as `read_rows`.
        EndpointError: if the disk fails or memory is short.
    """
    path, table = folder / part.path, table_of(part.path)
    assert table, "the manifest lists files of tables only"
    data = files.read(path)
    if hashlib.sha256(data).hexdigest() != part.sha256:
        raise InputError(str(path), "is damaged: its sha256 differs from the manifest; restore a copy")
    rows = read_rows(path, table, data)
    if Part.of(part.path, rows, part.sha256) != part:
        raise InputError(str(path), "has other rows or times than in the manifest; restore a copy of both")
    return rows


def read_rows(path: Path, table: Table, data: bytes) -> pa.Table:
    """Return the columns of a table from the content of a Parquet file; `path` names it in errors.

    Raises:
        InputError: if it is damaged, lacks a column or has more than `UNPACKED_LIMIT` bytes.
        EndpointError: if memory is short.
    """
    try:
        file: Any = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        cells, about = cells_of(file.schema_arrow), file.metadata
        stored = sum(about.row_group(each).total_byte_size for each in range(about.num_row_groups))
        if max(stored, about.num_rows * packed_type(table.kind, cells).itemsize) > UNPACKED_LIMIT:
            reason = f"unpacks to more than {UNPACKED_LIMIT // files.MiB} MiB, the limit for such a file"
            raise InputError(str(path), reason)
        expected = schema(table, cells=cells)
        _check_columns(path, file.schema_arrow, expected)
        # without Arrow's threads: one that releases `data` last aborts a process that is exiting
        rows: pa.Table = file.read(expected.names, use_threads=False)
        rows.validate(full=True)
    except MemoryError as error:
        raise EndpointError(str(path), files.NO_MEMORY) from error
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(str(path), f"is damaged or not a Parquet file: {reason}; restore a copy") from error
    for name in expected.names:
        if rows[name].null_count or flat(rows[name]).null_count:
            raise InputError(str(path), f"column {name!r} has nulls, must have none")
    return rows


def _digest(lines: str) -> str:
    return hashlib.sha256(lines.encode()).hexdigest()


def _part(where: str, content: Any) -> Part:
    """Return a valid part of a manifest."""
    values: dict[str, Any] = content if isinstance(content, dict) else {}
    if {key: type(value) for key, value in values.items()} == _TYPES:
        part, table = Part(**values), table_of(values["path"])
        whole = part.rows > 0 or (not (part.rows or part.first or part.last) and table and not table.parted)
        times = -_TIME_LIMIT <= part.first <= part.last < _TIME_LIMIT
        if table and whole and times and _SHA256.fullmatch(part.sha256):
            return part
    raise InputError(where, f"must be {', '.join(_TYPES)} of a file of the session; {_FIX}")


def _encodings(schema: pa.Schema) -> dict[str, str]:
    """Return the Parquet encoding of each column by its path in the file."""
    encodings: dict[str, str] = {}
    for field in schema:
        nested = pa.types.is_fixed_size_list(field.type)
        path = f"{field.name}.list.element" if nested else field.name
        kind = field.type.value_type if nested else field.type
        if pa.types.is_integer(kind):
            encodings[path] = "DELTA_BINARY_PACKED"
        elif pa.types.is_floating(kind):
            encodings[path] = "BYTE_STREAM_SPLIT"
    return encodings


def _check_columns(path: Path, found: pa.Schema, expected: pa.Schema) -> None:
    columns = {field.name: field for field in found}
    for field in expected:
        other = columns.get(field.name)
        if other is None:
            raise InputError(str(path), f"has no column {field.name!r}; it has {', '.join(columns)}")
        if found.names.count(field.name) > 1:
            raise InputError(str(path), f"has several columns {field.name!r}")
        if _with_any_index(other.type) != _with_any_index(field.type):
            raise InputError(str(path), f"column {field.name!r} is {other.type}, must be {field.type}")
        one, must_be = (
            (each.metadata or {}).get(b"unit", b"").decode(errors="replace") for each in (other, field)
        )
        if one != must_be:
            raise InputError(str(path), f"column {field.name!r} is in {one!r}, must be in {must_be!r}")


def _with_any_index(kind: Any) -> Any:
    """Return a type; if it is a dictionary, with one index type: pyarrow 16 reads int32 for all."""
    return pa.dictionary(pa.int32(), kind.value_type) if pa.types.is_dictionary(kind) else kind

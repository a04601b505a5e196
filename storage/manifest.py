"""Manifest of a session: its Parquet files with rows, time range and sha256, and a sha256 of the list."""

import hashlib
import json
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, cast

from operators.batch import s
from operators.errors import InputError
from operators.ports import Description
from storage import files
from storage.description import recorders
from storage.layout import MANIFEST, TABLES, is_table_file, may_exist, missing_files, part_number

VERSION: Final = 2

_FIX: Final = "slipflow recover rewrites the manifest"
_SHA256: Final = re.compile("[0-9a-f]{64}")
_TIME_LIMIT: Final = 2**63  # ns; every time is below
_TYPES: Final = {"path": str, "rows": int, "first": int, "last": int, "sha256": str}


@dataclass(frozen=True)
class Part:
    """One committed Parquet file."""

    path: str  # within the folder of the session
    rows: int
    first: int  # ns, earliest event time; 0 without rows
    last: int  # ns, latest event time; 0 without rows
    sha256: str  # hex

    @cached_property
    def line(self) -> str:
        """Line of the manifest; cached, since a manifest is rewritten with every part."""
        return json.dumps(vars(self))  # `asdict` takes five times as long

    @property
    def extent(self) -> str:
        """Rows and duration as text.

        >>> Part("touch/part-000000.parquet", 6000, 0, 60 * s, "0" * 64).extent
        '6,000 rows, 60.0 s'
        """
        return f"{self.rows:,} rows, {(self.last - self.first) / s:.1f} s"


def write_manifest(folder: Path, parts: Iterable[Part], put: files.Put = files.put) -> None:
    """Replace a session's manifest.

    Raises:
        OSError: if it cannot be written; the old or the new manifest remains.
    """
    lines = ",\n".join(part.line for part in parts)
    text = f'{{"version": {VERSION}, "parts": [\n{lines}\n], "sha256": "{_digest(lines)}"}}\n'
    put(folder / MANIFEST, text.encode())


def read_manifest(folder: Path) -> dict[str, Part]:
    """Return the parts in the manifest of a session by path; none if there is no manifest.

    Raises:
        InputError: if the manifest is damaged.
    """
    path = folder / MANIFEST
    if not may_exist(path):
        return {}
    content = files.read_json(path, files.LIST_LIMIT)
    version = content.get("version")
    if version != VERSION or not isinstance(content.get("parts"), list):
        reason = f'must have "version": {VERSION} and a list "parts"; {_FIX}'
        raise InputError(str(path), reason)
    parts = [_part(f"{path}, part {number}", each) for number, each in enumerate(content["parts"])]
    listed = {part.path: part for part in parts}
    if len(listed) < len(parts):
        raise InputError(str(path), f"lists a part twice; {_FIX}")
    if content.get("sha256") != _digest(",\n".join(part.line for part in parts)):
        raise InputError(str(path), f"is damaged: its sha256 differs from that of its parts; {_FIX}")
    return listed


def missing_parts(paths: Collection[str]) -> list[str]:
    """Return the parts whose numbers are missing before the last of each table, as `missing_files`.

    >>> missing_parts(["touch/part-000000.parquet", "touch/part-000002.parquet", "slips.parquet"])
    ['touch/part-000001.parquet']
    """
    missing = list[str]()
    for table in TABLES:
        if table.parted:
            numbers = [part_number(path) for path in paths if path.startswith(f"{table.name}/")]
            missing += missing_files(numbers, 0, table.file)
    return missing


def missing_rows(about: Description, parts: Iterable[Part]) -> str:
    """Return a line with the number of recorded rows of a closed session that no part has, empty if none."""
    sinks = cast("dict[str, dict[str, int]]", about.get("sinks", {}))
    try:
        written = [sinks[name]["rows"] for name in recorders(about)]
    except (AttributeError, LookupError, TypeError):  # reported when the description is checked
        return ""
    found = sum(part.rows for part in parts)
    if len(written) != 1 or found >= written[0]:  # several sinks are several datasets
        return ""
    return f"{written[0] - found:,} of the {written[0]:,} recorded rows are in no part"


def _digest(lines: str) -> str:
    return hashlib.sha256(lines.encode()).hexdigest()


def _part(where: str, content: Any) -> Part:  # noqa: ANN401 - any JSON
    values: dict[str, Any] = cast("dict[str, Any]", content) if isinstance(content, dict) else {}
    if {key: type(value) for key, value in values.items()} != _TYPES:
        raise InputError(where, f"must have {', '.join(_TYPES)}, of the right types; {_FIX}")
    part = Part(**values)
    times = -_TIME_LIMIT <= part.first <= part.last < _TIME_LIMIT
    empty = not part.rows and not part.first and not part.last and "/" not in part.path  # a single-file table
    if (part.rows < 1 and not empty) or not times or not _SHA256.fullmatch(part.sha256):
        raise InputError(where, f"has invalid rows, times or sha256; {_FIX}")
    if not is_table_file(part.path):
        raise InputError(where, f"{part.path!r} is not a file of a session; {_FIX}")
    return part

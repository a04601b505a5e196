"""The manifest of a session: its Parquet files with rows, time range and sha256, and a sha256 of all that."""

import hashlib
import json
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, cast

from operators.errors import InputError
from storage import files
from storage.layout import MANIFEST, TABLES, may_be

VERSION: Final = 2  # 1 had no sha256 of its own

_FILE: Final = re.compile(
    "|".join(rf"{t.name}/part-\d{{6,}}\.parquet" if t.parted else re.escape(t.file(0)) for t in TABLES)
)
_MENDED: Final = "slipflow recover makes the manifest anew"
_SHA256: Final = re.compile("[0-9a-f]{64}")
_TIMES: Final = 2**63  # ns, which no time reaches
_TYPES: Final = {"path": str, "rows": int, "first": int, "last": int, "sha256": str}


@dataclass(frozen=True)
class Part:
    """One committed Parquet file."""

    path: str  # within the session's folder
    rows: int
    first: int  # ns, earliest event time; 0 where there are no rows
    last: int  # ns, latest event time; the same
    sha256: str  # hex

    @cached_property
    def line(self) -> str:
        """It as one line of the manifest, made once: a day's manifest is written thousands of times."""
        return json.dumps(asdict(self))


def write_manifest(folder: Path, parts: Iterable[Part], put: files.Put = files.put) -> None:
    """Replace a session's manifest.

    Raises:
        OSError: the old one is still there, or the new one already is.
    """
    lines = ",\n".join(part.line for part in parts)
    text = f'{{"version": {VERSION}, "parts": [\n{lines}\n], "sha256": "{_digest(lines)}"}}\n'
    put(folder / MANIFEST, text.encode())


def read_manifest(folder: Path) -> dict[str, Part]:
    """The parts that a session's manifest lists, by path; none where no manifest was written yet.

    Raises:
        InputError: if the manifest is damaged.
    """
    path = folder / MANIFEST
    if not may_be(path):
        return {}
    content = files.read_json(path)
    version = content.get("version")
    if version not in {1, VERSION} or not isinstance(content.get("parts"), list):
        reason = f'must hold "version": {VERSION}, or 1, and a list "parts"; {_MENDED}'
        raise InputError(str(path), reason)
    parts = [_part(f"{path}, part {number}", each) for number, each in enumerate(content["parts"])]
    listed = {part.path: part for part in parts}
    if len(listed) < len(parts):
        raise InputError(str(path), f"lists a part twice; {_MENDED}")
    if version == VERSION and content.get("sha256") != _digest(",\n".join(part.line for part in parts)):
        raise InputError(str(path), f"is damaged: its sha256 is not that of the parts; {_MENDED}")
    return listed


def hint_manifest(folder: Path) -> dict[str, Part]:
    """The parts that a damaged manifest still tells of, by path: a hint, of which any word may be wrong."""
    found = dict[str, Part]()
    try:
        lines = files.read(folder / MANIFEST, 64 * files.MiB).decode(errors="replace").splitlines()
    except InputError:
        return found
    for line in lines:  # a part each, as `write_manifest` writes them
        with suppress(InputError, ValueError, RecursionError):
            part = _part(line, json.loads(line.strip().removesuffix(",")))
            found[part.path] = part
    return found


def _parted(path: str) -> bool:
    """Whether a file is one of several of its table, which are written only for rows."""
    return "/" in path


def _digest(lines: str) -> str:
    return hashlib.sha256(lines.encode()).hexdigest()


def _part(where: str, content: Any) -> Part:  # noqa: ANN401 - whatever the file holds
    values: dict[str, Any] = cast("dict[str, Any]", content) if isinstance(content, dict) else {}
    if {key: type(value) for key, value in values.items()} != _TYPES:
        raise InputError(where, f"must have {', '.join(_TYPES)}, of the right types; {_MENDED}")
    part = Part(**values)
    times = -_TIMES <= part.first <= part.last < _TIMES
    empty = not part.rows and not part.first and not part.last and not _parted(part.path)
    if (part.rows < 1 and not empty) or not times or not _SHA256.fullmatch(part.sha256):
        raise InputError(where, f"has rows, times or a sha256 that cannot be; {_MENDED}")
    if not _FILE.fullmatch(part.path):
        raise InputError(where, f"{part.path!r} is no file of a session; {_MENDED}")
    return part

"""Files that the manifest of a session does not list, and files that are missing."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import cast

from operators.batch import s
from operators.errors import InputError
from operators.ports import Description
from storage.description import recorders
from storage.layout import JOURNAL, TABLES, Table, inside, segment_file, segments, single_log
from storage.manifest import Part
from storage.parts import inspect_part, read_part
from storage.schema import schema, time_schema, times


def part_number(path: str) -> int:
    """Return the number of a part by its path, 0 for a single-file table.

    >>> part_number("touch/part-000012.parquet"), part_number("slips.parquet")
    (12, 0)
    """
    stem = path.rpartition("-")[2].partition(".")[0]
    return int(stem) if stem.isdigit() else 0


def duplicate_reason(folder: Path, table: Table, part: Part, known: Iterable[Part]) -> str:
    """Return the reason why a file duplicates rows of its table, empty if it does not.

    A duplicate is a copy of another part, or has rows of a fingertip that are not later than those of the
    parts with lower numbers.

    Args:
        folder: Folder of the session.
        table: Table of the file.
        part: The file.
        known: The other parts of the table.

    Raises:
        InputError: if the file cannot be read; others that are damaged are ignored.
    """
    others = list(known)
    for other in others:
        if other.sha256 == part.sha256:
            return f"{part.path}: is a copy of {other.path}"
    for other in others:
        before, after = sorted((part, other), key=lambda each: part_number(each.path))
        if before.last > after.first and _overlap(folder, table, before, after, part):
            return f"{part.path}: has rows of the same time as {other.path}"
    return ""


def without_duplicates(
    folder: Path, table: Table, paths: Sequence[str], listed: Mapping[str, Part]
) -> list[str]:
    """Return the files of a table without unlisted duplicates; unreadable files are kept."""
    known, found = [listed[path] for path in paths if path in listed], list[str]()
    for path in paths:
        if path not in listed:
            try:
                part = inspect_part(folder, path, schema(table))
                if duplicate_reason(folder, table, part, known):
                    continue
            except InputError:
                pass  # reported when it is read
            else:
                known.append(part)
        found.append(path)
    return found


def missing_parts(paths: Iterable[str]) -> list[str]:
    """Return the parts whose numbers are missing before the last of each table.

    >>> missing_parts(["touch/part-000000.parquet", "touch/part-000002.parquet", "slips.parquet"])
    ['touch/part-000001.parquet']
    """
    existing, missing = set(paths), list[str]()
    for table in TABLES:
        if table.parted:
            numbers = [part_number(path) for path in existing if path.startswith(f"{table.name}/")]
            expected = map(table.file, range(max(numbers, default=-1)))
            missing += [path for path in expected if path not in existing]
    return missing


def missing_segments(folder: Path, about: Description) -> list[str]:
    """Return a line for each segment that is missing from a journal; none if there is no journal."""
    numbers = list(segments(folder))
    if not numbers:
        expected = (folder / JOURNAL).is_dir() and "end_ns" not in about
        return [f"{JOURNAL}: has no segment: the newest rows are lost"] if expected else []
    gaps = sorted(set(range(numbers[0], numbers[-1])) - set(numbers))
    lost = [segment_file(number) for number in gaps]
    if not single_log(folder).exists() and "end_ns" not in about:  # it is created before all others
        lost.append(single_log(folder).relative_to(folder.resolve()).as_posix())
    return [f"{path}: is missing, with its rows" for path in lost]


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


def extent(part: Part) -> str:
    """Return rows and duration of a part as text.

    >>> extent(Part("touch/part-000000.parquet", 6000, 0, 60 * s, "0" * 64))
    '6,000 rows, 60.0 s'
    """
    return f"{part.rows:,} rows, {(part.last - part.first) / s:.1f} s"


def _overlap(folder: Path, table: Table, before: Part, after: Part, part: Part) -> bool:
    """Return true if a fingertip has rows in `after` that are older than one in `before`."""
    spans = list[dict[int, tuple[int, int]]]()
    for each in (before, after):
        try:
            spans.append(_spans(folder, table, each))
        except InputError:
            if each is part:
                raise
            return False  # unknown, since the other is damaged
    ends, begins = spans
    return any(begins[finger][0] < ends[finger][1] for finger in ends.keys() & begins.keys())


def _spans(folder: Path, table: Table, part: Part) -> dict[int, tuple[int, int]]:
    """Return the earliest and latest time (ns) by fingertip."""
    rows = read_part(inside(folder, folder / part.path), time_schema(table), part.sha256)
    return {finger: (int(time.min()), int(time.max())) for finger, time in times(table, rows).items()}

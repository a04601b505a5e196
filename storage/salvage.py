"""How a session is put right: parts that no manifest lists, then the journal."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, cast

import pyarrow as pa

from operators.batch import Batch, Zeroed
from operators.errors import InputError
from operators.ports import Description
from storage import files, frames
from storage.description import describe_recovery
from storage.journal import drop_journal
from storage.layout import (
    DAMAGED,
    JOURNAL,
    MANIFEST,
    TABLE_OF,
    TABLES,
    TOUCH,
    Table,
    inside,
    segments,
    single_log,
)
from storage.manifest import Part, hint_manifest, read_manifest, write_manifest
from storage.parts import commit_part, inspect_part, read_part
from storage.recovered import Recovery
from storage.schema import batch_type, schema, to_arrow
from storage.unlisted import doubled, extent, missing_numbers, missing_segments, part_number, shortfall

PART_ROWS: Final = 100_000  # of a part


class Salvage:
    """One session being put right; nobody else writes to it."""

    def __init__(self, folder: Path, about: Description) -> None:
        """Look at all that is there; nothing is changed.

        Raises:
            InputError: if the journal is of another version, or a link leads out of the session.
        """
        self._folder, self._about, self._session = folder, about, str(about["session"])
        self._lost: list[str] = []
        self._cut: list[str] = []  # of these, what tells of the end only
        self._done: list[str] = []
        self._journalled = (folder / JOURNAL).is_dir()
        before = cast("dict[str, Any]", about.get("recovered", {}))
        self._known_lost: list[str] = before.get("lost", [])
        self._known_cut: list[str] = before.get("cut", [])
        self._adopted: list[str] = []
        # by table, why its last file cannot be read, which no manifest lists
        self._doubtful: dict[str, str] = {}
        self._holes: set[str] = set()  # tables of which a part is gone that no manifest lists
        self._unreadable: set[str] = set()  # files of tables
        self._aside: list[Path] = []  # what is kept as it is, but not read any more
        self._listed = dict[str, Part]()
        self._hints = dict[str, Part]()  # what a damaged manifest lists
        self._mend = not (folder / MANIFEST).exists()
        try:
            self._listed |= read_manifest(folder)
        except InputError:
            self._mend = True
            self._hints |= hint_manifest(folder)
        self._were = dict(self._listed)
        self._parts = {table.name: self._found(table) for table in TABLES}
        self._rows: dict[str, list[Batch]] = {}  # from the journal, by table
        self._empty = list[Table]()  # tables of one file that got no row, and still lack it
        self._read_journal()
        self._lost += [reason for table, reason in self._doubtful.items() if table not in self._rows]
        self._look_for_gone()

    def carry_out(self) -> Recovery:
        """Put it right.

        Raises:
            OSError: it may be tried again.
        """
        before = {table.name: self._count(self._known(table)) for table in TABLES}
        for table in TABLES:
            rows = self._rows.get(table.name, [table.kind.empty()] if table in self._empty else [])
            if rows:
                self._commit(table, to_arrow(table, rows))
        after = {name: self._count(parts) for name, parts in self._parts.items()}
        found = {name: rows - before[name] for name, rows in after.items() if rows > before[name]}
        parts = [part for each in self._parts.values() for part in each]
        rewritten = self._mend or {part.path: part for part in parts} != self._were
        if rewritten and not found:
            self._done.append("its manifest was made anew")
        if self._journalled and not found:
            self._done.append("its journal was put away: it had no row that no part has")
        result = Recovery(
            self._session, found, tuple(self._adopted), self._new_lost(), tuple(self._cut), tuple(self._done)
        )
        self._describe(result)
        if rewritten:
            self._keep_manifest()
            write_manifest(self._folder, parts)
        left = self._clear()
        return replace(result, done=(*result.done, *left))

    def _found(self, table: Table) -> list[Part]:
        """The parts of a table: those listed, and those that are whole."""
        parts = self._known(table)
        there = {path.relative_to(self._folder).as_posix() for path in self._folder.glob(table.pattern)}
        for path in sorted(there - {part.path for part in parts}, key=part_number):
            try:
                part = inspect_part(self._folder, path, schema(table))
                twice = doubled(self._folder, table, part, parts)
            except InputError as error:
                self._damaged(table, path, error, last=path == max(there, key=part_number))
                continue
            if twice:
                self._aside.append(self._folder / path)
                self._done.append(f"{twice}: it is kept in {DAMAGED!r}")
                continue
            parts.append(part)
            self._adopted.append(path)
        return sorted(parts, key=lambda part: part_number(part.path))

    def _known(self, table: Table) -> list[Part]:
        paths = (path for path in self._listed if path.startswith((f"{table.name}/", f"{table.name}.")))
        return [self._listed[path] for path in sorted(paths, key=part_number)]

    def _look_for_gone(self) -> None:
        """What is missing altogether: parts that are known of, rows that session.json counts, the journal."""
        parts = [part for each in self._parts.values() for part in each]
        hashes = {part.sha256 for part in parts}
        paths = {part.path for part in parts} | self._unreadable
        for path, part in self._hints.items():
            if not (self._folder / path).exists() and part.sha256 not in hashes:
                self._lost.append(f"{path}: is gone: {extent(part)}")
        told = " ".join([*self._lost, *self._known_lost])
        gone = [path for path in missing_numbers(paths) if path not in told]
        self._lost += [f"{path}: is gone, and no manifest tells of it" for path in gone]
        if self._mend and not self._journalled and (text := shortfall(self._about, parts)):
            self._lost.append(text)
        if "end_ns" in self._about:
            return
        if not parts and not self._rows:
            self._done.append("was never closed, and has no rows")
        elif not self._journalled:
            self._cut.append("was never closed and has no journal: what came after its last part is missing")
            self._lost += self._cut[-1:]

    def _new_lost(self) -> tuple[str, ...]:
        return tuple(each for each in self._lost if each not in self._known_lost)

    def _damaged(self, table: Table, path: str, error: InputError, *, last: bool) -> None:
        """A file that no manifest lists: the journal still has its rows, unless others came after it."""
        self._aside.append(self._folder / path)
        self._unreadable.add(path)
        if last and segments(self._folder):
            self._doubtful[table.name] = f"{table.name}: {error}"
        else:
            self._holes.add(table.name)
            self._lost.append(f"{table.name}: {error}")

    def _read_journal(self) -> None:
        """Gather its rows, up to the first of each table that is missing."""
        next_row = {name: self._count(parts) for name, parts in self._parts.items()}
        left_out = dict[str, int]()  # rows by table
        logs, single = segments(self._folder), single_log(self._folder)
        newest = [next(reversed(logs.values()), None), single]
        logs |= {frames.SINGLE_LOG: single} if single.exists() else {}
        gone = missing_segments(self._folder, self._about)
        self._lost += gone if any(self._parts.values()) or segments(self._folder) else []
        for number, path in logs.items():
            segment = frames.read_segment(files.read(path, frames.WHOLE), str(path), self._session, number)
            for rows in segment.rows:
                table, end = TABLE_OF[type(rows.batch)].name, rows.first + len(rows.batch)
                if table in left_out or table in self._holes or rows.first > next_row[table]:
                    left_out[table] = left_out.get(table, 0) + len(rows.batch)
                elif end > next_row[table]:
                    self._rows.setdefault(table, []).append(rows.batch[next_row[table] - rows.first :])
                    next_row[table] = end
            self._look_at(path, segment.damage, last=path in newest)
        for table, rows_left in left_out.items():
            self._lost.append(f"{table}: {rows_left} rows that do not follow on row {next_row[table]}")
        if left_out:
            self._aside += [path for path in logs.values() if path not in self._aside]
        elif single.exists() and single not in self._aside:
            self._empty += [table for table in TABLES if self._got_nothing(table)]

    def _got_nothing(self, table: Table) -> bool:
        """Whether a table of one file, to which rows might have come, got none."""
        name = table.name
        known = self._parts[name] or name in self._rows or name in self._doubtful or name in self._holes
        wired = cast("list[str]", self._about.get("tables", []))
        return not table.parted and not known and name in wired

    def _look_at(self, path: Path, damage: frames.Damage | None, *, last: bool) -> None:
        """Tell of the damage to a segment, the last of its kind or not."""
        if damage:
            behind = "whole frames are behind it" if damage.more else "there the recorder was cut off"
            self._lost.append(f"{path.name}: its last {damage.size} bytes cannot be read: {behind}")
            self._aside += [path] if damage.more else []
            self._cut += self._lost[-1:] if last and not damage.more else []

    def _commit(self, table: Table, rows: pa.Table) -> None:
        parts = self._parts[table.name]
        if not table.parted:
            before = [read_part(self._folder / part.path, schema(table), part.sha256) for part in parts]
            self._parts[table.name] = [
                commit_part(self._folder, table.file(0), pa.concat_tables([*before, rows]))
            ]
            return
        files.make_folder(inside(self._folder, self._folder / table.name))
        number = 1 + max((part_number(part.path) for part in parts), default=-1)
        for start in range(0, len(rows), PART_ROWS):
            parts.append(commit_part(self._folder, table.file(number), rows.slice(start, PART_ROWS)))
            number += 1

    def _describe(self, result: Recovery) -> None:
        before = cast("dict[str, Any]", self._about.get("recovered", {}))
        found = bool(result.rows or result.adopted)
        if not (found or result.lost) and (before or "end_ns" in self._about):
            return
        rows, adopted = (
            (result.rows, list(result.adopted))
            if found
            else (before.get("rows", {}), before.get("adopted", []))
        )
        parts = [part for each in self._parts.values() for part in each if part.rows]
        newest = max((part.last for part in parts), default=None)
        describe_recovery(
            self._folder,
            self._about,
            {
                "rows": dict(rows),
                "adopted": adopted,
                "lost": [*self._known_lost, *result.lost],
                "cut": [*self._known_cut, *(each for each in result.cut if each not in self._known_cut)],
            },
            newest=newest,
            zeroed=self._zeroed(),
        )

    def _zeroed(self) -> bool:
        """Whether the touch was recorded zeroed."""
        touch = self._parts[TOUCH.name]
        if not touch:
            return False
        try:
            return batch_type(read_part(self._folder / touch[0].path, schema(TOUCH))) is Zeroed
        except InputError:
            return False

    def _keep_manifest(self) -> None:
        """A damaged one is kept aside before it is made anew."""
        path = self._folder / MANIFEST
        if self._mend and path.exists():
            files.make_folder(self._folder / DAMAGED)
            files.put(self._folder / DAMAGED / MANIFEST, files.read(path))

    def _clear(self) -> list[str]:
        """Delete what is not needed any more, and say so; keep aside what could not be read."""
        deleted = 0
        for pattern in ("*", "*/*"):
            for path in self._folder.glob(pattern + files.SCRATCH):
                if path.parent.name != JOURNAL:
                    inside(self._folder, path.parent)
                    path.unlink(missing_ok=True)
                    deleted += 1
        if self._aside:
            files.make_folder(self._folder / DAMAGED)
        for path in self._aside:
            name = path.relative_to(self._folder).as_posix().replace("/", "-")
            if path.exists() and path.relative_to(self._folder).as_posix() not in self._paths():
                path.replace(self._folder / DAMAGED / name)
        if self._aside:
            files.sync(self._folder / DAMAGED)
        if (self._folder / JOURNAL).is_dir():
            drop_journal(self._folder)
        return [f"{deleted} files that were never whole were deleted"] if deleted else []

    def _paths(self) -> set[str]:
        return {part.path for parts in self._parts.values() for part in parts}

    @staticmethod
    def _count(parts: Iterable[Part]) -> int:
        return sum(part.rows for part in parts)

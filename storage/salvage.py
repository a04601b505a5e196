"""How a session is put right: parts that no manifest lists, then the journal."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from operators.batch import Batch, Zeroed
from operators.errors import InputError
from operators.ports import Description
from storage import episodes, files, frames
from storage.description import describe_recovery
from storage.episodes import Episodes
from storage.journal import drop_journal
from storage.layout import (
    DAMAGED,
    EPISODES,
    JOURNAL,
    MANIFEST,
    TABLE_OF,
    TABLES,
    TOUCH,
    Table,
    inside,
    segments,
)
from storage.manifest import Part, read_manifest, write_manifest
from storage.parts import commit_part, described, hash_part, read_part
from storage.recovery import Recovery
from storage.schema import batch_type, schema, to_arrow

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
        self._adopted: list[str] = []
        self._doubtful: dict[
            str, str
        ] = {}  # by table, why its last file cannot be read, which no manifest lists
        self._holes: set[str] = set()  # tables of which a part is gone that no manifest lists
        self._aside: list[Path] = []  # what is kept as it is, but not read any more
        self._listed = dict[str, Part]()
        self._mend = not (folder / MANIFEST).exists()
        try:
            self._listed |= read_manifest(folder)
        except InputError:
            self._mend = True
        self._were = dict(self._listed)
        self._parts = {table.name: self._found(table) for table in TABLES}
        self._rows: dict[str, list[Batch]] = {}  # from the journal, by table
        self._episodes = self._read_journal()
        self._lost += [reason for table, reason in self._doubtful.items() if table not in self._rows]

    def carry_out(self) -> Recovery:
        """Put it right.

        Raises:
            OSError: it may be tried again.
        """
        before = {table.name: self._count(self._known(table)) for table in TABLES}
        told = self._commit_episodes()
        for table in TABLES:
            if rows := self._rows.get(table.name):
                self._commit(table, to_arrow(table, rows, told))
        after = {name: self._count(parts) for name, parts in self._parts.items()}
        found = {name: rows - before[name] for name, rows in after.items() if rows > before[name]}
        result = Recovery(self._session, found, tuple(self._adopted), tuple(self._lost))
        self._describe(result)
        parts = [part for each in self._parts.values() for part in each]
        if EPISODES in self._listed:
            parts.append(self._listed[EPISODES])
        if self._mend or {part.path: part for part in parts} != self._were:
            write_manifest(self._folder, parts)
        self._clear()
        return result

    def _found(self, table: Table) -> list[Part]:
        """The parts of a table: those listed, and those that are whole."""
        parts = self._known(table)
        there = {path.relative_to(self._folder).as_posix() for path in self._folder.glob(table.pattern)}
        for path in sorted(there - {part.path for part in parts}, key=_number):
            try:
                part = self._checked(path, schema(table))
            except InputError as error:
                self._damaged(table, path, error, last=path == max(there, key=_number))
                continue
            parts.append(part)
            self._adopted.append(path)
        return parts

    def _known(self, table: Table) -> list[Part]:
        paths = (path for path in self._listed if path.startswith((f"{table.name}/", f"{table.name}.")))
        return [self._listed[path] for path in sorted(paths, key=_number)]

    def _checked(self, path: str, columns: pa.Schema, times: tuple[str, str] = ("time", "time")) -> Part:
        place = inside(self._folder, self._folder / path)
        sha256 = hash_part(place)
        return described(path, read_part(place, columns, sha256), sha256, times)

    def _damaged(self, table: Table, path: str, error: InputError, *, last: bool) -> None:
        """A file that no manifest lists: the journal still has its rows, unless others came after it."""
        self._aside.append(self._folder / path)
        if last and segments(self._folder):
            self._doubtful[table.name] = f"{table.name}: {error}"
        else:
            self._holes.add(table.name)
            self._lost.append(f"{table.name}: {error}")

    def _read_journal(self) -> list[Any] | None:
        """Gather its rows, up to the first of each table that is missing; give its episodes."""
        told: list[Any] | None = None
        next_row = {name: self._count(parts) for name, parts in self._parts.items()}
        left_out = dict[str, int]()  # rows by table
        for number, path in segments(self._folder).items():
            segment = frames.read_segment(files.read(path, frames.WHOLE), str(path), self._session, number)
            told = segment.episodes or told
            for rows in segment.rows:
                table, end = TABLE_OF[type(rows.batch)].name, rows.first + len(rows.batch)
                if table in left_out or table in self._holes or rows.first > next_row[table]:
                    left_out[table] = left_out.get(table, 0) + len(rows.batch)
                elif end > next_row[table]:
                    self._rows.setdefault(table, []).append(rows.batch[next_row[table] - rows.first :])
                    next_row[table] = end
            if damage := segment.damage:
                behind = "whole frames are behind it" if damage.more else "there the recorder was cut off"
                self._lost.append(f"{path.name}: its last {damage.size} bytes cannot be read: {behind}")
                self._aside += [path] if damage.more else []
        for table, rows_left in left_out.items():
            self._lost.append(f"{table}: {rows_left} rows that do not follow on row {next_row[table]}")
        if left_out:
            self._aside += [path for path in segments(self._folder).values() if path not in self._aside]
        return told

    def _commit_episodes(self) -> Episodes:
        """The episodes, those that only the journal knows included."""
        there, found = self._folder / EPISODES, Episodes.described({})
        if there.exists():
            try:
                listed = self._listed.get(EPISODES)
                sha256 = listed.sha256 if listed else None
                found = Episodes(read_part(inside(self._folder, there), episodes.SCHEMA, sha256))
                self._listed[EPISODES] = listed or self._checked(EPISODES, episodes.SCHEMA, episodes.TIMES)
            except InputError as error:
                self._lost.append(f"episodes: {error}")
        told = Episodes.described({"the journal": {"episodes": self._episodes or []}})
        if len(told.table) < len(found.table) or told.table.equals(found.table):
            return found
        self._listed[EPISODES] = commit_part(self._folder, EPISODES, told.table, episodes.TIMES)
        return told

    def _commit(self, table: Table, rows: pa.Table) -> None:
        parts = self._parts[table.name]
        if not table.parted:
            before = [read_part(self._folder / part.path, schema(table), part.sha256) for part in parts]
            self._parts[table.name] = [
                commit_part(self._folder, table.file(0), pa.concat_tables([*before, rows]))
            ]
            return
        files.make_folder(inside(self._folder, self._folder / table.name))
        number = 1 + max((_number(part.path) for part in parts), default=-1)
        for start in range(0, len(rows), PART_ROWS):
            parts.append(commit_part(self._folder, table.file(number), rows.slice(start, PART_ROWS)))
            number += 1

    def _describe(self, result: Recovery) -> None:
        ended, before = "end_ns" in self._about, "recovered" in self._about
        if not (result.rows or result.adopted) and (before or (ended and not result.lost)):
            return
        newest = max((part.last for parts in self._parts.values() for part in parts), default=None)
        describe_recovery(
            self._folder,
            self._about,
            {"rows": dict(result.rows), "adopted": list(result.adopted), "lost": list(result.lost)},
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

    def _clear(self) -> None:
        """Delete what is not needed any more; keep aside what could not be read."""
        for pattern in ("*", "*/*"):
            for path in self._folder.glob(pattern + files.SCRATCH):
                if path.parent.name != JOURNAL:
                    inside(self._folder, path.parent)
                    path.unlink(missing_ok=True)
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

    def _paths(self) -> set[str]:
        return {part.path for parts in self._parts.values() for part in parts}

    @staticmethod
    def _count(parts: Iterable[Part]) -> int:
        return sum(part.rows for part in parts)


def _number(path: str) -> int:
    """Of a part, by its path; 0 for a table of one file."""
    stem = path.rpartition("-")[2].partition(".")[0]
    return int(stem) if stem.isdigit() else 0

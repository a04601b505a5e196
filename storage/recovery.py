"""Recovery of a session whose recorder was killed, or whose files were damaged."""

import os
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, cast

from operators.batch import Batch, Zeroed
from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Description
from storage import files
from storage.append_log import Damage
from storage.arrow import pa
from storage.buffer import Buffer
from storage.description import describe_recovery, read_session
from storage.journal import SINGLE, SegmentReader, delete_journal, missing_segments
from storage.layout import (
    DAMAGED,
    JOURNAL,
    LABELS,
    MANIFEST,
    TABLES,
    TOUCH,
    Table,
    check_links,
    files_of,
    may_exist,
    part_number,
    segments,
    single_log,
    table_files,
)
from storage.lock import lock
from storage.manifest import Part, missing_parts, missing_rows, read_manifest, write_manifest
from storage.parts import commit_part, inspect_part, read_part
from storage.schema import batch_type, schema, to_arrow

PART_ROWS: Final = 100_000  # of a part made from the journal


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery."""

    session: str
    rows: Mapping[str, int]  # recovered rows by table
    adopted: tuple[str, ...]  # complete files that were not in the manifest
    lost: tuple[str, ...]  # a line for each loss that was not known before
    cut: tuple[str, ...]  # those of `lost` at the end, where the recorder was killed
    done: tuple[str, ...]  # a line for each other repair

    @property
    def complete(self) -> bool:
        """True if nothing was lost."""
        return not self.lost

    @property
    def changed(self) -> bool:
        """True if anything was repaired or lost."""
        return bool(self.rows or self.adopted or self.lost or self.done)


def recover(folder: str | Path) -> Recovery:
    """Repair a session, so that all its rows are in parts that its manifest lists.

    Complete files that are not listed are added to the manifest, except copies of others. The rows of
    the journal become parts, table by table, up to the first missing row: a table never has a gap. Missing
    parts are reported as lost. Unreadable files, copies and a damaged manifest are moved to the folder
    `damaged`. Finally session.json records the recovery, and the journal is deleted. A session that needs
    no repair is not changed; a recovery that was killed can be run again.

    Args:
        folder: Folder of the session.

    Raises:
        InputError: if it is not a session, its journal has another version, or it contains a link; nothing
            is changed then.
        EndpointError: if it is being recorded, cannot be written, or the disk fails.
    """
    folder = Path(folder)
    check_links(folder)
    read_session(folder)  # before the lock: an invalid session is an InputError
    try:
        with _exclusive(folder):
            return Repair(folder, read_session(folder)).finish()  # as a concurrent recovery has left it
    except OSError as error:
        reason = f"cannot be recovered: {os_error_reason(error)}"
        raise EndpointError(str(error.filename or folder), reason) from error


@contextmanager
def _exclusive(folder: Path) -> Generator[None]:
    """Lock a session against recorders and other recoveries."""
    held = list[int]()
    try:
        with suppress(FileNotFoundError):  # concurrent recoveries wait here, and then find no journal
            turn = lock(folder / JOURNAL, wait=True)
            held += [] if turn is None else [turn]
        own = lock(folder)
        if own is None:
            raise EndpointError(str(folder), "is being recorded: recover it when the recording ends")
        held.append(own)
        yield
    finally:
        for number in reversed(held):
            os.close(number)


class Repair:
    """Repair of one session: the constructor examines it and changes nothing; `finish` needs its lock.

    Attributes:
        lost: A line for each loss that no earlier recovery has recorded.
        cut: Those of `lost` at the end, where the recorder was killed.
        done: A line for each other repair.
        adopted: Complete files that are not in the manifest.

    Raises:
        InputError: if the journal has another version.
    """

    def __init__(self, folder: Path, about: Description) -> None:
        self._folder, self._about, self._session = folder, about, str(about["session"])
        self.lost, self.cut, self.done = list[str](), list[str](), list[str]()  # as in `Recovery`
        self.adopted: list[str] = []
        self._journalled = (folder / JOURNAL).is_dir()
        self._before = cast("dict[str, Any]", about.get("recovered", {}))  # by earlier recoveries
        self._known_lost: list[str] = self._before.get("lost", [])
        self._known_cut: list[str] = self._before.get("cut", [])
        self._doubtful: dict[str, str] = {}  # reason by table whose last file is unlisted and unreadable
        self._with_gaps: set[str] = set()  # tables with an unreadable file that the journal cannot replace
        self._unreadable: set[str] = set()  # files of tables
        self._aside: list[Path] = []  # files to be moved to `damaged`
        self._listed = dict[str, Part]()  # of the manifest, by path
        self._rewrite = not may_exist(folder / MANIFEST)
        try:
            self._listed |= read_manifest(folder)
        except InputError:
            self._rewrite = True
        self._listed_before = dict(self._listed)
        self._parts = {table.name: self._find_parts(table) for table in TABLES}
        self._logs, single = segments(folder), single_log(folder)
        self._newest = [next(reversed(self._logs.values()), None), single]
        self._logs |= {SINGLE: single} if may_exist(single) else {}
        self._rows = Counter[str]()  # that the journal adds, by table
        self._left_out = Counter[str]()  # rows of the journal that do not follow, by table
        self._empty = list[Table]()  # single-file tables without rows whose file is still missing
        self._read_journal()
        self.lost += [reason for table, reason in self._doubtful.items() if table not in self._rows]
        self._find_missing()
        self.lost = [each for each in self.lost if each not in self._known_lost]

    def finish(self) -> Recovery:
        """Repair the session.

        Raises:
            OSError: it may be tried again.
        """
        before = {table.name: _count(self._listed_of(table)) for table in TABLES}
        self._commit_journal()
        after = {name: _count(parts) for name, parts in self._parts.items()}
        found = {name: rows - before[name] for name, rows in after.items() if rows > before[name]}
        parts = self._all_parts()
        rewritten = self._rewrite or {part.path: part for part in parts} != self._listed_before
        if rewritten and not found:
            self.done.append("its manifest was rewritten")
        if self._journalled and not found:
            self.done.append("its journal was deleted: all its rows are in parts")
        lost, cut = tuple(self.lost), tuple(self.cut)
        result = Recovery(self._session, found, tuple(self.adopted), lost, cut, tuple(self.done))
        self._describe(result)
        if rewritten:
            self._keep_manifest()
            write_manifest(self._folder, parts)
        return replace(result, done=(*result.done, *self._clean_up()))

    def _all_parts(self) -> list[Part]:
        return [part for each in self._parts.values() for part in each]

    def _listed_of(self, table: Table) -> list[Part]:
        return [self._listed[path] for path in sorted(filter(table.has, self._listed), key=part_number)]

    def _find_parts(self, table: Table) -> list[Part]:
        """Return the listed parts of a table and the unlisted complete ones."""
        parts = self._listed_of(table)
        existing = table_files(self._folder, table)
        for path in existing:
            if path in self._listed:
                continue
            try:
                part = inspect_part(self._folder, path, table)
            except InputError as error:
                self._add_unreadable(table, path, error, last=path == existing[-1])
                continue
            if original := next((each.path for each in parts if each.sha256 == part.sha256), None):
                self._aside.append(self._folder / path)
                self.done.append(f"{path}: is a copy of {original}: it is kept in {DAMAGED!r}")
            else:
                parts.append(part)
                self.adopted.append(path)
        return sorted(parts, key=lambda part: part_number(part.path))

    def _add_unreadable(self, table: Table, path: str, error: InputError, *, last: bool) -> None:
        """Note an unreadable, unlisted file; the journal still has the rows of a table's last file."""
        self._aside.append(self._folder / path)
        self._unreadable.add(path)
        if last and segments(self._folder):
            self._doubtful[table.name] = f"{error}; it is not in the manifest"
        else:
            self._with_gaps.add(table.name)
            self.lost.append(f"{error}; it is not in the manifest")

    def _find_missing(self) -> None:
        """Note missing parts, missing rows of a closed session, and a missing journal."""
        parts = self._all_parts()
        paths = {part.path for part in parts} | self._unreadable
        reported = " ".join([*self.lost, *self._known_lost])
        missing = [path for path in missing_parts(paths) if path not in reported]
        self.lost += [f"{path}: is missing, and not in the manifest" for path in missing]
        if self._rewrite and not self._journalled and (text := missing_rows(self._about, parts)):
            self.lost.append(text)
        if "end_ns" in self._about:
            return
        if not parts and not self._rows:
            self.done.append("was not closed, and has no rows")
        elif not self._journalled:
            self.cut.append("was not closed and has no journal: rows after its last part are missing")
            self.lost += self.cut[-1:]

    def _read_journal(self) -> None:
        """Count the rows of the journal that follow those in parts."""
        missing = missing_segments(self._folder, self._about)
        self.lost += missing if any(self._parts.values()) or segments(self._folder) else []
        damages = dict[Path, Damage | None]()
        for table, rows in self._journal_rows(damages):
            self._rows[table.name] += len(rows)
        for path, damage in damages.items():
            self._add_damage(path, damage, last=path in self._newest)
        for name, rows_left in self._left_out.items():
            follow = _count(self._parts[name]) + self._rows[name]
            self.lost.append(f"{name}: {rows_left} rows that do not follow row {follow}")
        if self._left_out:
            self._aside += [path for path in self._logs.values() if path not in self._aside]
        elif SINGLE in self._logs and self._logs[SINGLE] not in self._aside:
            self._empty += [table for table in TABLES if self._is_empty(table)]

    def _journal_rows(self, damages: dict[Path, Damage | None]) -> Iterator[tuple[Table, Batch]]:
        """Yield the rows that follow those in parts, up to the first missing row of each table.

        Count the others in `_left_out`, and note the damage of each segment.
        """
        next_row = {name: _count(parts) for name, parts in self._parts.items()}
        self._left_out.clear()
        for number, path in self._logs.items():
            with SegmentReader(path, self._session, number) as reader:
                for rows in reader.rows():
                    table, end = rows.table, rows.first + len(rows.batch)
                    name, next_of_table = table.name, next_row[rows.table.name]
                    if name in self._left_out or name in self._with_gaps or rows.first > next_of_table:
                        self._left_out[name] += len(rows.batch)
                    elif end > next_of_table:
                        next_row[name] = end
                        yield table, rows.batch[next_of_table - rows.first :]
                damages[path] = reader.damage

    def _commit_journal(self) -> None:
        """Commit the rows of the journal, with no more than a part of each multi-part table in memory."""
        buffers = {table.name: Buffer(table.kind) for table in self._empty}
        for table, rows in self._journal_rows({}):
            buffer = buffers.setdefault(table.name, Buffer(type(rows), cells=rows.cells))
            for start in range(0, len(rows), PART_ROWS):
                some = rows[start : start + PART_ROWS]
                if table.parted and buffer.rows + len(some) > PART_ROWS:
                    self._commit(table, buffer)
                    buffer = buffers[table.name] = Buffer(type(rows), cells=rows.cells)
                buffer.add(some)
        for table in TABLES:
            if table.name in buffers:
                self._commit(table, buffers[table.name])

    def _is_empty(self, table: Table) -> bool:
        """Return true for a single-file table that session.json declares and that got no rows."""
        name = table.name
        known = self._parts[name] or name in {*self._rows, *self._doubtful, *self._with_gaps}
        return not table.parted and not known and name in cast("list[str]", self._about.get("tables", []))

    def _add_damage(self, path: Path, damage: Damage | None, *, last: bool) -> None:
        """Note the damage of a segment; `last` if it is the newest segment or the single-file log."""
        if damage:
            reason = "whole frames follow" if damage.more else "the recorder was cut off there"
            self.lost.append(f"{path.name}: its last {damage.size} bytes cannot be read: {reason}")
            self._aside += [path] if damage.more else []
            self.cut += self.lost[-1:] if last and not damage.more else []

    def _commit(self, table: Table, buffer: Buffer) -> None:
        """Write rows as the next part of a multi-part table, or append them to a single file."""
        rows = to_arrow(table, buffer.batches() or [buffer.kind.zeros(0, buffer.cells)])
        parts = self._parts[table.name]
        if table.parted:
            files.make_folder(self._folder / table.name)
            number = 1 + max((part_number(part.path) for part in parts), default=-1)
            parts.append(commit_part(self._folder, table.file(number), rows))
        else:
            before = [read_part(self._folder / part.path, schema(table), part.sha256) for part in parts]
            whole = pa.concat_tables([*before, rows])
            self._parts[table.name] = [commit_part(self._folder, table.file(0), whole)]

    def _describe(self, result: Recovery) -> None:
        """Record the recovery in session.json."""
        found = bool(result.rows or result.adopted)
        if not (found or result.lost) and (self._before or "end_ns" in self._about):
            return
        rows, adopted = self._before.get("rows", {}), self._before.get("adopted", [])
        if found:
            rows, adopted = result.rows, list(result.adopted)
        describe_recovery(
            self._folder,
            self._about,
            {
                "rows": dict(rows),
                "adopted": adopted,
                "lost": [*self._known_lost, *result.lost],
                "cut": [*self._known_cut, *(each for each in result.cut if each not in self._known_cut)],
            },
            newest=max((part.last for part in self._all_parts() if part.rows), default=None),
            zeroed=self._zeroed(),
        )

    def _zeroed(self) -> bool:
        """Return true if touch was recorded zeroed."""
        touch = self._parts[TOUCH.name]
        if not touch:
            return False
        try:
            return batch_type(read_part(self._folder / touch[0].path, schema(TOUCH))) is Zeroed
        except InputError:
            return False

    def _keep_manifest(self) -> None:
        """Move a damaged manifest to `damaged` before it is rewritten."""
        path = self._folder / MANIFEST
        if self._rewrite and may_exist(path):
            files.make_folder(self._folder / DAMAGED)
            files.rename(path, self._folder / DAMAGED / MANIFEST)
            files.sync(self._folder / DAMAGED)

    def _clean_up(self) -> list[str]:
        """Delete temporary files and the journal, move files to `damaged`; return lines for `done`."""
        deleted = 0
        for path in scratch_files(self._folder):
            files.unlink(path)
            deleted += 1
        if self._aside:
            files.make_folder(self._folder / DAMAGED)
        kept = {part.path for part in self._all_parts()}
        for path in self._aside:
            name = path.relative_to(self._folder).as_posix()
            if may_exist(path) and name not in kept:
                files.rename(path, self._folder / DAMAGED / name.replace("/", "-"))
        if self._aside:
            files.sync(self._folder / DAMAGED)
        if (self._folder / JOURNAL).is_dir():
            delete_journal(self._folder)
        return [f"{deleted} incomplete files were deleted"] if deleted else []


def scratch_files(folder: Path) -> list[Path]:
    """Return the temporary files that a killed process has left in a session, except in its journal."""
    patterns = "*", f"{LABELS}/*", *(f"{table.name}/*" for table in TABLES if table.parted)
    found = (path for each in patterns for path in files_of(folder, each + files.SCRATCH))
    return [path for path in found if not path.is_dir()]


def _count(parts: Iterable[Part]) -> int:
    return sum(part.rows for part in parts)

"""Recovery of a session whose recorder was killed."""

import os
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from operator import attrgetter
from pathlib import Path
from typing import Any, cast

from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Description
from storage import files
from storage.append_log import LogReader
from storage.description import describe_recovery, read_session
from storage.files import lock
from storage.journal import Buffer, NumberedRows, check_segment, decode, delete_journal, journal_files
from storage.layout import (
    DAMAGED,
    JOURNAL,
    LABEL_FILES,
    MANIFEST,
    SEGMENTS,
    SESSION,
    TABLE_OF,
    TABLES,
    Table,
    check_links,
    file_number,
    may_exist,
    numbered_files,
)
from storage.parts import PART_ROWS, Part, read_manifest, read_part, read_rows, write_manifest, write_parts
from storage.schema import to_arrow


def recover(folder: str | Path) -> "Recovery":
    """Repair a session, so that all its rows are in parts that its manifest lists.

    The rows of the journal become parts, table by table, up to the first missing row: a table never has a
    gap. They replace listed parts that are damaged or missing, and those after them. A part that the manifest
    does not list is deleted if the journal has its rows, else moved to the folder `damaged`, as are damaged
    segments of the journal. Finally session.json records the recovery, and the journal is deleted. A session
    that needs no repair is not changed; a recovery that was killed can be run again.

    Raises:
        InputError: if it is not a session, its manifest is damaged, its journal has another version, or it
            contains a link; nothing is changed then.
        EndpointError: if it is being recorded, cannot be written, or the disk fails.
    """
    folder = Path(folder)
    check_links(folder)
    read_session(folder)  # before the lock: an invalid session is an InputError
    try:
        with _exclusive(folder):
            recovery = Recovery(folder, read_session(folder))  # as a concurrent one has left it
            recovery.finish()
            return recovery
    except OSError as error:
        reason = f"cannot be recovered: {os_error_reason(error)}"
        raise EndpointError(str(error.filename or folder), reason) from error


@contextmanager
def _exclusive(folder: Path) -> Generator[None]:
    """Lock a session against recorders and other recoveries."""
    with ExitStack() as stack:
        with suppress(FileNotFoundError):  # concurrent recoveries wait here, and then find no journal
            stack.enter_context(files.exclusive(folder / JOURNAL))
        own = lock(folder)
        if own is None:
            raise EndpointError(str(folder), "is being recorded: recover it when the recording ends")
        stack.callback(os.close, own)
        yield


class Recovery:
    """Recovery of one session: the constructor examines it and changes nothing; `finish` needs its lock.

    Attributes:
        session: Name of the session.
        rows: Recovered rows by table; known after `finish`.
        lost: A line for each loss that no earlier recovery has recorded.
        cut: Those of `lost` at the end, where the recorder was killed.
        done: A line for each other repair.
    """

    def __init__(self, folder: Path, about: Description) -> None:
        self._folder, self._about, self.session = folder, about, str(about["session"])
        self.rows = dict[str, int]()
        self.lost, self.cut, self.done = list[str](), list[str](), list[str]()
        self._before = cast("dict[str, Any]", about.get("recovered", {}))  # by earlier recoveries
        self._listed = listed = read_manifest(folder, about)
        self._parts = {table: [part for path, part in listed.items() if table.has(path)] for table in TABLES}
        self._logs = numbered_files(folder, SEGMENTS)
        self._damaged = list[Path]()  # segments to be kept
        self._buffers = dict[Table, Buffer]()  # that the journal adds
        self._read_journal()
        self._repeated, self._unknown = list[Path](), list[Path]()  # parts that are not listed
        kept = {folder / part.path for part in self._all_parts()}
        for table in TABLES:
            strays = [path for path in numbered_files(folder, table.pattern).values() if path not in kept]
            if strays:
                (self._repeated if self._has_journal_of(table, strays) else self._unknown).extend(strays)
        names = [path.relative_to(folder).as_posix() for path in self._unknown]
        self.done += [f"{each}: is not in the manifest" for each in names if each not in listed]
        if not self._buffers and (folder / JOURNAL).is_dir() and journal_files(folder):
            self.done.append("its journal was deleted: all its rows are in parts")
        if "end_ns" not in about and not self._logs and not self._before:
            if self._all_parts() or self._unknown:
                self.lost.append("was not closed and lacks its journal: rows after its last part are missing")
            else:
                self.done.append("was not closed, and has no rows")
        known = self._before.get("lost", [])
        self.lost, self.cut = ([each for each in of if each not in known] for of in (self.lost, self.cut))

    @property
    def changed(self) -> bool:
        """True if anything was repaired or lost."""
        return bool(self.rows or self.lost or self.done)

    def finish(self) -> None:
        """Repair the session.

        Raises:
            OSError: it may be tried again.
        """
        for path in self._unknown:
            self._move_away(path)
        for table in (table for table in TABLES if table in self._buffers):
            before = self._parts[table] if table.parted else []
            number = 1 + max((file_number(table.pattern, part.path) or 0 for part in before), default=-1)
            new = to_arrow(table, self._buffers[table].batches())
            parts = write_parts(self._folder, table, new, number=number, limit=PART_ROWS)
            self.rows[table.name] = len(new) - (0 if table.parted else _count(self._parts[table]))
            self._parts[table] = [*before, *parts]
        if self.rows or self.lost or not (self._before or "end_ns" in self._about):
            recovered = {
                "rows": self.rows or self._before.get("rows", {}),
                "lost": [*self._before.get("lost", []), *self.lost],
                "cut": [*self._before.get("cut", []), *self.cut],
            }
            newest = max((part.last for part in self._all_parts() if part.rows), default=None)
            describe_recovery(self._folder, self._about, recovered, newest=newest)
        if set(self._all_parts()) != {*self._listed.values()} or not may_exist(self._folder / MANIFEST):
            write_manifest(self._folder, self._all_parts(), about=self._about)
        self._clean_up()

    def _all_parts(self) -> list[Part]:
        return [part for each in self._parts.values() for part in each]

    def _read_journal(self) -> None:
        """Read the rows of the journal up to the first missing row of each table, and note what is lost."""
        left_out, listed = Counter[Table](), {table: _count(each) for table, each in self._parts.items()}
        for first, batch in self._journal_rows():
            table = TABLE_OF[type(batch)]
            if table not in self._buffers:
                self._leave_out_damaged_parts(table, first)
                start = _count(self._parts[table]) if table.parted else 0  # single files are written anew
                self._buffers[table] = Buffer(type(batch), start, batch.cells)
            buffer = self._buffers[table]
            if table in left_out or first > buffer.end or batch.cells != buffer.cells:
                left_out[table] += len(batch)
            elif first + len(batch) > buffer.end:
                buffer.add(batch[buffer.end - first :])
        for table, parts in self._parts.items():
            added, end = self._buffers.get(table), _count(parts)
            if added is not None and added.end <= end:
                del self._buffers[table]  # its parts have them already
            elif added is not None:
                end = added.end
            if table in left_out:
                self.lost.append(f"{table.name}: {left_out[table]} rows that do not follow row {end}")
                self._damaged = list(self._logs.values())
            if (missing := listed[table] - end) > 0:
                self.lost.append(f"{table.name}: {missing} rows of damaged parts, after row {end}")

    def _leave_out_damaged_parts(self, table: Table, first: int) -> None:
        """Keep the listed parts of a table before the first damaged one whose rows the journal has.

        The journal has the rows from number `first` on.
        """
        parts = self._parts[table]
        for number, part in enumerate(parts):
            try:
                if _count(parts[:number]) >= first:
                    read_part(self._folder, part)
            except InputError as error:
                self.done.append(f"{error}; the journal has its rows")
                self._parts[table] = parts[:number]
                return

    def _journal_rows(self) -> Iterator[NumberedRows]:
        """Yield the rows of all segments, those of single-file tables last; each segment repeats these.

        Note damages of segments.
        """
        single = list[NumberedRows]()
        for number, path in self._logs.items():
            reader = LogReader(path)
            check_segment(reader, self.session, number)
            for record in reader.records():
                rows = decode(record.data, str(path))
                if TABLE_OF[type(rows.batch)].parted:
                    yield rows
                else:
                    single.append(rows)
            if damage := reader.damage:
                reason = "the recorder was cut off there" if damage.torn else "it is damaged"
                self.lost.append(f"{path.name}: its last {damage.size} bytes cannot be read: {reason}")
                self.cut += self.lost[-1:] if damage.torn and number == max(self._logs) else []
                self._damaged += [] if damage.torn else [path]
        yield from sorted(single, key=attrgetter("first"))

    def _has_journal_of(self, table: Table, strays: list[Path]) -> bool:
        """Return true if the rows of parts that are not listed are the first ones that the journal adds."""
        try:
            times = [read_rows(path, table, files.read(path))["time"].to_numpy() for path in strays]
        except InputError:
            return False
        added = self._buffers[table].batches() if table in self._buffers else []
        found, known = (
            b"".join(each.tobytes() for each in of) for of in (times, [each.time for each in added])
        )
        return bool(self._logs) and known.startswith(found)

    def _clean_up(self) -> None:
        """Delete temporary files, repeated parts and the journal; keep damaged files."""
        for path in self._damaged:
            self._move_away(path)
        listed = {self._folder / part.path for part in self._all_parts()}
        scratch = scratch_files(self._folder)
        for path in (*scratch, *(path for path in self._repeated if path not in listed)):
            path.unlink(missing_ok=True)
        if (self._folder / JOURNAL).is_dir():
            delete_journal(self._folder)
        self.done += [f"{len(scratch)} incomplete files were deleted"] if scratch else []

    def _move_away(self, path: Path) -> None:
        """Move a file to the folder `damaged`, under a name that is free."""
        files.make_folder(self._folder / DAMAGED)
        name = path.relative_to(self._folder).as_posix().replace("/", "-")
        names = (f"{name}.{number}" if number else name for number in count())
        free = next(each for each in names if not may_exist(self._folder / DAMAGED / each))
        path.replace(self._folder / DAMAGED / free)
        files.sync(self._folder / DAMAGED)


def scratch_files(folder: Path) -> list[Path]:
    """Return the temporary files that a killed process has left in a session, except in its journal."""
    patterns = SESSION, MANIFEST, LABEL_FILES, *(table.pattern for table in TABLES)
    found = (path for each in patterns for path in numbered_files(folder, each + files.SCRATCH).values())
    return [path for path in found if not path.is_dir()]


def _count(parts: Iterable[Part]) -> int:
    return sum(part.rows for part in parts)

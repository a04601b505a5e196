"""A session while it is recorded: rows gather in memory and are committed as Parquet parts."""

import os
import weakref
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from shutil import rmtree
from threading import Lock

from operators.batch import EVERY, Batch, Zeroed
from operators.errors import EndpointError, ParameterError, os_error_reason
from operators.ports import Run
from storage import files
from storage.buffer import Buffer
from storage.description import describe_dataset, describe_session
from storage.frames import Rows
from storage.growing import Growing
from storage.journal import Journal
from storage.layout import SESSIONS, TABLE_OF, TABLES, TOUCH, Table, session_folder
from storage.lock import lock
from storage.manifest import Part, write_manifest
from storage.parts import commit_part
from storage.schema import to_arrow
from storage.unsettled import Unsettled


class SessionWriter:
    """One session being written. Apart from `full`, `add` and `take`, its methods wait for the disk.

    All tables are committed together, so that their parts cover the same time. A live run's rows are in a
    journal until then, so that a crash does not cost them. A replay can be made again: it is made durable all
    at once, before it is declared ended.
    """

    def __init__(self, root: Path, run: Run, part_span: int, part_rows: int, host: str | None = None) -> None:
        """Make the session's folder and say in it what is known at the beginning.

        Raises:
            EndpointError: if the dataset cannot be written to, or has a session of that name.
            ParameterError: if the session's name is no file name.
            InputError: if dataset.json or a source's description is not as it must be, or the folder holds
                other files and is no dataset.
        """
        self.folder = session_folder(root, run.session)
        self._root, self._run, self._part_span, self._part_rows = root, run, part_span, part_rows
        self._host = host
        kinds = run.sink_types.get(str(root), ())
        self._tables = [table for table in TABLES if table in map(TABLE_OF.get, kinds)]  # that may get rows
        self._buffers: dict[str, Buffer | Growing] = {
            table.name: Growing(table.kind) for table in self._tables if not table.parted
        }
        self._taken: dict[str, Buffer | Growing] | None = None  # what the commit that is due is about
        self._rotated = self._behind = False  # of that commit: the journal has gone on; it failed
        self._parts: list[Part] = []
        self._numbers = Counter[str]()  # of parts, by table
        self._gathering = Lock()  # guards the buffers; never held while the disk works
        self._writing = Lock()  # a commit goes on in its thread when the task that awaited it is cancelled
        self._journal: Journal | None = None
        self._unsettled = None if run.live else Unsettled()
        self._put = self._unsettled.put if self._unsettled else files.put
        self._make_folder = self._unsettled.make_folder if self._unsettled else files.make_folder
        if root.exists() and not root.is_dir():
            raise EndpointError(str(root), "is a file, must be a folder: give the dataset another name")
        with self._reporting():
            root.mkdir(parents=True, exist_ok=True)
            describe_dataset(root)
            self._make_folder(root / SESSIONS)
            try:
                self._make_folder(self.folder, new=True)
            except FileExistsError:
                reason = f"has a session {run.session!r} already; give this one another name"
                raise EndpointError(str(root), reason) from None
            held = None
            try:
                held = lock(self.folder)
                describe_session(self.folder, run, host=host, tables=self._tables, put=self._put)
                write_manifest(self.folder, self._parts, self._put)
                if run.live:
                    self._journal = Journal(self.folder, run.session)
            except BaseException:
                rmtree(self.folder, ignore_errors=True)
                if held is not None:
                    os.close(held)
                raise
        self._leave = weakref.finalize(self, _leave, self._journal, held)

    @property
    def journalled(self) -> bool:
        """Whether what gathers survives a crash: a commit then need not be waited for."""
        return self._journal is not None

    @property
    def behind(self) -> bool:
        """Whether a commit has failed, which has to be made good before more is taken."""
        return self._behind

    def full(self, batch: Batch) -> bool:
        """Whether to commit before `batch` is added.

        Raises:
            ParameterError: if no table takes it.
            BatchError: if it is broken: it would spoil the part that it goes into.
        """
        kind, table = type(batch), TABLE_OF.get(type(batch))
        if table is None:
            known = ", ".join(each.__name__ for each in TABLE_OF)
            raise ParameterError("Dataset", "batch", kind.__name__, f"one of {known}")
        if not table.finger and batch.finger != EVERY:
            raise ParameterError("Dataset", f"finger of a {kind.__name__}", batch.finger, f"EVERY ({EVERY})")
        buffer = self._buffers.get(table.name)
        if buffer and buffer.kind is not kind:
            reason = f"{buffer.kind.__name__}: a session keeps either raw or zeroed counts"
            raise ParameterError("Dataset", "batch", kind.__name__, reason)
        rows = len(batch.check())
        if self._behind or (self._journal and self._journal.suspect):
            return True
        if not rows or not isinstance(buffer, Buffer) or not buffer.rows:
            return False
        rows, first, last = buffer.plus(batch)
        return rows > self._part_rows or last - first >= self._part_span

    def add(self, batch: Batch) -> bool:
        """Keep a batch, which `full` has seen, until the next commit.

        False: not taken, since the journal is behind; `append` waits for it.
        """
        if not len(batch):
            return True
        with self._gathering:
            buffer = self._buffer(batch)
            if self._journal and not self._journal.add(Rows(buffer.end, batch)):
                return False
            buffer.add(batch)
        return True

    def append(self, batch: Batch) -> None:
        """Keep a batch as `add` does once it is in the journal.

        Raises:
            EndpointError: if it cannot be written; it was not taken.
        """
        assert self._journal, "without one, add takes all"
        with self._reporting(), self._journal.held():
            buffer = self._buffer(batch)
            self._journal.append(Rows(buffer.end, batch))
            with self._gathering:
                self._buffer(batch).add(batch)

    def take(self, *, final: bool = False) -> None:
        """What has gathered is what the next commit is about; `final`: the tables of one file, too."""
        if self._taken is None:
            tables = [table for table in TABLES if table.parted or final]
            with self._gathering:
                found = {table.name: self._buffers.get(table.name) for table in tables}
                self._taken = {
                    name: buffer
                    for name, buffer in found.items()
                    if buffer and (buffer.rows or (final and self._is_due_empty(name)))
                }
                for name, buffer in self._taken.items():
                    self._buffers[name] = type(buffer)(buffer.kind, buffer.end)
            self._rotated = final  # nothing stays behind

    def commit(self, *, final: bool = False) -> None:
        """Write what was taken, or else what has gathered, as parts and then the manifest.

        Raises:
            EndpointError: what could not be committed is kept for the next try.
        """
        with self._writing, self._reporting():
            try:
                self.take(final=final)
                self._commit_taken()
            except BaseException:
                self._behind = True
                raise
            self._behind = False

    def close(self) -> None:
        """Commit everything, declare the session ended and let go of it.

        Raises:
            EndpointError: it may be called again.
        """
        if self._journal:
            self._journal.stop()
        if self._taken is not None:
            self.commit()
        self.commit(final=True)
        touch = self._buffers.get(TOUCH.name)
        with self._reporting():
            if self._unsettled:
                self._unsettled.settle()
            zeroed = touch is not None and touch.kind is Zeroed
            describe_session(
                self.folder, self._run, host=self._host, tables=self._tables, zeroed=zeroed, ended=True
            )
            if self._journal:
                self._journal.remove()
        self._leave()

    def _buffer(self, batch: Batch) -> Buffer | Growing:
        table = TABLE_OF[type(batch)]
        found = self._buffers.get(table.name)
        if found is None:
            found = self._buffers[table.name] = (Buffer if table.parted else Growing)(type(batch))
        return found

    def _is_due_empty(self, table: str) -> bool:
        """Whether a table of one file, which has no rows, still lacks the file that says so."""
        return isinstance(self._buffers[table], Growing) and not self._numbers[table]

    def _kept(self, form: type[Buffer | Growing]) -> list[Rows]:
        """The rows that are not taken, of tables of parts or of one file."""
        with self._gathering:
            kept = [buffer for buffer in self._buffers.values() if isinstance(buffer, form)]
            return [rows for buffer in kept for rows in buffer.numbered()]

    def _commit_taken(self) -> None:
        """In this order, so that at each step all rows are in a listed part or in the journal."""
        assert self._taken is not None, "take comes first"
        if self._journal and not self._rotated:
            self._journal.rotate(partial(self._kept, Buffer), partial(self._kept, Growing))
            self._rotated = True
        for table in TABLES:
            if buffer := self._taken.get(table.name):
                self._commit_rows(table, buffer)
                del self._taken[table.name]
        write_manifest(self.folder, self._parts, self._put)
        if self._journal:
            self._journal.drop()
        self._taken = None

    def _commit_rows(self, table: Table, buffer: Buffer | Growing) -> None:
        rows = to_arrow(table, buffer.batches or [buffer.kind.empty()])
        parts, some = list[Part](), max(len(rows), 1)
        size = self._part_rows if table.parted else some
        if table.parted:
            self._make_folder(self.folder / table.name)
        for start in range(0, some, size):  # more than one part only where one batch is larger
            path = table.file(self._numbers[table.name] + len(parts))
            parts.append(commit_part(self.folder, path, rows.slice(start, size), put=self._put))
        self._parts += parts
        self._numbers[table.name] += len(parts)

    @contextmanager
    def _reporting(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            raise EndpointError(str(self._root), f"cannot be written: {os_error_reason(error)}") from error


def _leave(journal: Journal | None, held: int | None) -> None:
    """Let go of a session, also one that was never closed."""
    if journal:
        journal.leave()
    if held is not None:
        os.close(held)

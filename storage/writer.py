"""Writer of a session: rows are buffered in memory and committed as Parquet parts."""

import os
import weakref
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree

from operators.batch import EVERY, Batch
from operators.errors import EndpointError, ParameterError, os_error_reason
from operators.ports import Description, Run
from storage import arrow, files
from storage.description import describe_dataset, describe_session
from storage.files import lock
from storage.journal import Buffer, Journal, NumberedRows, delete_journal
from storage.layout import FINGER_MAX, SESSIONS, TABLE_OF, TABLES, Table, new_session_folder
from storage.parts import Part, write_manifest, write_parts
from storage.schema import to_arrow


class SessionWriter:
    """Writer of one session, for a caller that decides when to append, sync and commit; it has no threads.

    Only `full`, `add` and `begin_commit` do not wait for the disk. `append`, `commit` and a sync of the
    journal may run in other threads, each once at a time. All tables are committed together, so that their
    parts cover the same time. The rows of a live run are in a journal until then. A replay can be repeated,
    so nothing of it is made durable. A part spans `part_span` (ns) and has `part_rows` at most.

    Attributes:
        folder: Folder of the session.
        journal: Journal of a live run, with which buffered rows survive a crash: then commits may run in the
            background.

    Raises:
        SlipflowError: as `storage.Dataset.open`.
    """

    def __init__(self, root: Path, run: Run, part_span: int, part_rows: int) -> None:
        arrow.load()
        self.folder = new_session_folder(root, run.session)
        self._root, self._run, self._part_span, self._part_rows = root, run, part_span, part_rows
        tables = map(TABLE_OF.get, run.sink_types.get(str(root), {}))
        self._buffers = {each.name: Buffer(each.kind) for each in tables if each and not each.parted}
        self._committing: dict[str, Buffer] | None = None  # buffers of the commit in progress
        self._single: list[NumberedRows] = []  # rows of single-file tables when the commit began
        self._failed = False  # the last commit failed: it must succeed before more rows are added
        self._parts: list[Part] = []
        self.journal: Journal | None = None
        if root.exists() and not root.is_dir():
            raise EndpointError(str(root), "is a file, must be a folder: give the dataset another name")
        with self._reporting():
            files.make_folder(root, parents=True)
            describe_dataset(root)
            files.make_folder(root / SESSIONS)
            try:
                files.make_folder(self.folder, new=True)
            except FileExistsError:
                reason = f"already has a session {run.session!r}; give this one another name"
                raise EndpointError(str(root), reason) from None
            held = None
            try:
                held = lock(self.folder)
                describe_session(self.folder, run, str(root))
                self._write_manifest()
                if run.live:
                    self.journal = Journal(self.folder, run.session)
            except BaseException:
                if held is not None:
                    os.close(held)
                rmtree(self.folder, ignore_errors=True)
                raise
        self._release = weakref.finalize(self, _release, self.journal, held)

    @property
    def exclusive(self) -> bool:
        """True if no rows may be added or appended while the rows of `begin_commit` are committed."""
        return self._failed or not self.journal or self.journal.suspect

    @property
    def pending(self) -> int:
        """Rows that are in no part and not safe in the journal."""
        if self.journal and not self.journal.suspect:
            return self.journal.pending
        return sum(each.rows for each in (*self._buffers.values(), *(self._committing or {}).values()))

    def full(self, batch: Batch) -> bool:
        """Return true if a commit is needed before `batch` is added.

        Raises:
            ParameterError: if no table has its type, or its table has rows with another number of cells.
            BatchError: if it is invalid.
        """
        kind, table = type(batch), TABLE_OF.get(type(batch))
        if table is None:
            known = ", ".join(each.__name__ for each in TABLE_OF)
            raise ParameterError("Dataset", "batch", kind.__name__, f"one of {known}")
        if not EVERY <= batch.finger <= (FINGER_MAX if table.finger else EVERY):
            must_be = f"from {EVERY} to {FINGER_MAX}" if table.finger else f"EVERY ({EVERY})"
            raise ParameterError("Dataset", f"finger of a {kind.__name__}", batch.finger, must_be)
        buffer = self._buffers.get(table.name)
        if buffer is not None and buffer.kind is not kind:
            reason = f"{buffer.kind.__name__}: a session has either raw or zeroed counts"
            raise ParameterError("Dataset", "batch", kind.__name__, reason)
        rows = len(batch.check())
        if rows and buffer is not None and buffer.cells != batch.cells:
            must_be = f"{buffer.cells}, as in the previous rows: record other fingertips in another session"
            raise ParameterError("Dataset", f"number of cells of a {kind.__name__}", batch.cells, must_be)
        if self._failed or (self.journal and self.journal.suspect):
            return True
        if not rows or not table.parted or buffer is None or not buffer.rows:
            return False
        rows, first, last = buffer.extent_with(batch)
        return rows > self._part_rows or last - first >= self._part_span

    def fits(self, batch: Batch) -> bool:
        """Return true if a batch, for which `full` was true, can be added while a commit is running."""
        buffer = self._buffers.get(TABLE_OF[type(batch)].name)
        return not self.exclusive and (buffer is None or buffer.rows + len(batch) <= self._part_rows)

    def add(self, batch: Batch) -> bool:
        """Buffer a batch, for which `full` was false or `fits` true, until the next commit.

        Returns:
            False if too many rows wait for the journal and the batch was not buffered: `append` it.
        """
        if len(batch):
            buffer = self._buffer(batch)
            if self.journal and not self.journal.add(NumberedRows(buffer.end, batch)):
                return False
            buffer.add(batch)
        return True

    def append(self, batch: Batch | None = None) -> None:
        """Append the waiting rows to the journal, then a batch that `add` refused; then buffer it.

        Raises:
            EndpointError: if they cannot be written; the batch was not buffered.
        """
        assert self.journal, "without a journal no rows wait"
        with self._reporting():
            if batch is None:
                self.journal.append()
            else:
                buffer = self._buffer(batch)
                self.journal.append(NumberedRows(buffer.end, batch))
                buffer.add(batch)

    def begin_commit(self, *, final: bool = False) -> None:
        """Select the buffered rows for the next commit; single-file tables only if it is `final`."""
        if self._committing is not None:
            return
        single = [each for each in self._buffers.values() if not TABLE_OF[each.kind].parted]
        self._committing = {
            name: buffer
            for name, buffer in self._buffers.items()
            if (final if buffer in single else buffer.rows)
        }
        if final:  # each single file is written once, also without rows
            self._buffers = {}
        for name, buffer in self._committing.items() if not final else ():
            self._buffers[name] = Buffer(buffer.kind, buffer.end, buffer.cells)
        if self.journal:
            self._single = [rows for buffer in single for rows in buffer.numbered()]
            self.journal.begin_commit()

    def commit(self, *, final: bool = False) -> None:
        """Write the selected rows, by default all buffered ones, as parts, then the manifest.

        Raises:
            EndpointError: rows that could not be committed are kept for the next try.
        """
        with self._reporting():
            try:
                self.begin_commit(final=final)
                self._commit_selected(final=final)
            except BaseException:
                self._failed = True
                raise
            self._failed = False

    def close(self) -> None:
        """Commit all rows, end the session and release it.

        Raises:
            EndpointError: it may be called again.
        """
        if self.journal:
            with suppress(OSError):  # they are committed from memory
                self.journal.append()
        if self._committing is not None:
            self.commit()
        self.commit(final=True)
        with self._reporting():
            describe_session(self.folder, self._run, str(self._root), ended=True)
            if self.journal:
                self.journal.close()
                delete_journal(self.folder)
        self._release()

    def _write_manifest(self) -> None:
        about: Description = {"session": self._run.session, "start_ns": self._run.start}
        write_manifest(self.folder, self._parts, about, durable=self._run.live)

    def _buffer(self, batch: Batch) -> Buffer:
        table = TABLE_OF[type(batch)].name
        if (found := self._buffers.get(table)) is None:
            found = self._buffers[table] = Buffer(type(batch), cells=batch.cells)
        return found

    def _commit_selected(self, *, final: bool) -> None:
        """Commit in an order that keeps all rows in a listed part or in the journal at each step."""
        assert self._committing is not None, "begin_commit comes first"
        for table in TABLES:
            if buffer := self._committing.get(table.name):
                self._commit_rows(table, buffer)
                del self._committing[table.name]
        self._write_manifest()
        if self.journal and not final:
            self.journal.rotate(self._single)
        self._committing = None

    def _commit_rows(self, table: Table, buffer: Buffer) -> None:
        rows = to_arrow(table, buffer.batches() or [buffer.kind.zeros(0, buffer.cells)])
        number = sum(table.has(part.path) for part in self._parts)
        limit, live = self._part_rows, self._run.live
        self._parts += write_parts(self.folder, table, rows, number=number, limit=limit, durable=live)

    @contextmanager
    def _reporting(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            named = isinstance(error.filename, str) and Path(error.filename).is_relative_to(self.folder)
            where = error.filename if named else str(self._root)
            raise EndpointError(where, f"cannot be written: {os_error_reason(error)}") from error


def _release(journal: Journal | None, held: int | None) -> None:
    """Release a session, even if it was never closed."""
    if journal:
        journal.close()
    if held is not None:
        os.close(held)

"""Journal of a session: rows that are not in a part yet, so that a crash loses only the newest ones."""

from collections import Counter
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from threading import Condition, Event, RLock, Thread
from typing import Final

from storage import steps
from storage.files import SCRATCH, make_folder, sync
from storage.journal_segment import SINGLE_LOG, NumberedRows, OpenSegment, bodies
from storage.layout import JOURNAL, TABLE_OF, segment_file, segments, single_log

APPEND_AT: Final = 5  # waiting rows of a table that trigger an append
MAX_WAITING: Final = 10  # rows of a table that may wait; a kill loses them
APPEND_INTERVAL: Final = 0.05  # s; a row waits no longer
SYNC_INTERVAL: Final = 1.0  # s, between two fsyncs


class Journal:
    """Segments of one session and the two threads that write them: one appends, one syncs.

    Appends continue during a slow fsync. Only `add` never waits for the disk. Single-file tables, which are
    written when the session ends, have their own segment until then.

    Args:
        folder: Folder of the session.
        session: Name of the session.

    Raises:
        OSError: if it cannot be written.
    """

    def __init__(self, folder: Path, session: str) -> None:
        self._folder, self._session = folder, session
        make_folder(folder / JOURNAL)
        self._single = OpenSegment(single_log(folder), session, SINGLE_LOG)  # created before all others
        self._segment = OpenSegment(folder / segment_file(0), session, 0)
        self._disk = RLock()  # held while frames are appended
        self._syncing = RLock()  # held while the segment is made durable; taken before _disk
        self._more = Condition()  # guards the following; never held during disk work
        self._pending: list[NumberedRows] = []
        self._waiting = Counter[str]()  # rows by table, including those being appended
        self._failing, self._ended = False, False
        self.suspect = False  # an fsync failed: its rows may be lost, and need a commit
        self._end = Event()
        self._threads = [Thread(target=each, daemon=True) for each in (self._append_soon, self._sync_often)]
        for thread in self._threads:
            thread.start()

    def add(self, rows: NumberedRows) -> bool:
        """Queue rows; return false if too many wait or the disk fails, and they were not queued."""
        table = TABLE_OF[type(rows.batch)].name
        with self._more:
            waiting = self._waiting[table] + len(rows.batch)
            if waiting > MAX_WAITING or self._failing or self._ended:
                return False
            self._waiting[table] = waiting
            self._pending.append(rows)
            if waiting >= APPEND_AT:
                self._more.notify()
        return True

    @contextmanager
    def held(self) -> Generator[None]:
        """Block other appends and new segments."""
        with self._disk:
            yield

    def append(self, *rows: NumberedRows) -> None:
        """Append the waiting rows, then `rows`, which belong to one table.

        Raises:
            OSError: nothing was appended; the waiting rows stay queued, `rows` do not.
        """
        with self._disk:
            waiting = self._take()
            if not waiting and not rows:
                return
            try:
                single = any(map(_single, rows))
                for of_single in (not single, single):  # `rows` last: if that fails, they are in no segment
                    self._write([each for each in chain(waiting, rows) if _single(each) is of_single])
            except BaseException:
                self._give_back(waiting)
                self._failing = True
                raise
            self._failing = False
            self._appended(waiting)

    def rotate(
        self, kept: Callable[[], Iterable[NumberedRows]], single: Callable[[], Iterable[NumberedRows]]
    ) -> None:
        """Begin the next segment with the rows that are not about to be committed.

        Args:
            kept: Returns those of multi-part tables.
            single: Returns all rows of single-file tables; they are written again only if an fsync failed.

        Raises:
            OSError: if it cannot be written; the old segment remains in use.
        """
        number = self._segment.number + 1
        fresh = OpenSegment(self._folder / segment_file(number), self._session, number)
        with self._syncing:
            with self._disk:
                waiting = self._take()  # some are about to be committed, but are in no part yet
                try:  # in order; duplicates have the same numbers
                    of_parts = [*(each for each in waiting if not _single(each)), *kept()]
                    fresh.append(bodies(sorted(of_parts, key=lambda rows: rows.first)))
                    self._continue_single(waiting, single)
                except BaseException:
                    self._give_back(waiting)
                    fresh.close()
                    raise
                old, self._segment = self._segment, fresh
                self._failing = self.suspect = False
                self._appended(waiting)
            with suppress(OSError):  # its rows are about to be in parts
                old.sync()
            old.close()

    def sync(self) -> None:
        """Make the appended rows durable.

        Raises:
            OSError: some rows may be lost; the journal is `suspect` until the next segment begins.
        """
        with self._syncing:
            try:
                self._single.sync()
                self._segment.sync()
            except OSError:
                # a second fsync could falsely succeed: the kernel may have dropped the unwritten pages
                self.suspect = True
                raise

    def drop(self) -> None:
        """Delete the older segments: their rows are in parts, or in the current one.

        Raises:
            OSError: some are left.
        """
        self.sync()
        for number, path in segments(self._folder).items():
            if number < self._segment.number:
                steps.reach("delete segment")
                path.unlink(missing_ok=True)
        sync(self._folder / JOURNAL)

    def stop(self) -> None:
        """End the threads and append the waiting rows, if the disk allows; may be called again."""
        with self._more:
            self._ended = True
            self._more.notify()
        self._end.set()
        for thread in self._threads:
            thread.join()
        with suppress(OSError):
            self.append()

    def remove(self) -> None:
        """Delete the stopped journal: all its rows are in parts.

        Raises:
            OSError: some of it is left.
        """
        self._close()
        delete_journal(self._folder)

    def leave(self) -> None:
        """Stop and close the journal without deleting it; may be called again."""
        self.stop()
        self._close()

    def _close(self) -> None:
        self._segment.close()
        self._single.close()

    def _write(self, rows: list[NumberedRows]) -> None:
        """Append rows of one segment."""
        if rows:
            (self._single if _single(rows[0]) else self._segment).append(bodies(rows))

    def _continue_single(
        self, waiting: list[NumberedRows], single: Callable[[], Iterable[NumberedRows]]
    ) -> None:
        """Append the waiting rows of single-file tables; after a failed fsync, write all to a new segment."""
        if self.suspect:
            fresh = OpenSegment(self._single.path, self._session, SINGLE_LOG, bodies(single()))
            self._single.close()
            self._single = fresh
        else:
            self._write([each for each in waiting if _single(each)])

    def _append_soon(self) -> None:
        while True:
            with self._more:
                if self._failing or max(self._waiting.values(), default=0) < APPEND_AT:
                    self._more.wait(APPEND_INTERVAL)
                if self._ended:
                    return
            with suppress(OSError):  # the next append reports it
                self.append()

    def _sync_often(self) -> None:
        while not self._end.wait(SYNC_INTERVAL):
            with suppress(OSError):  # the journal is suspect then
                self.sync()

    def _take(self) -> list[NumberedRows]:
        with self._more:
            waiting, self._pending = self._pending, []
        return waiting

    def _give_back(self, waiting: list[NumberedRows]) -> None:
        with self._more:
            self._pending[:0] = waiting

    def _appended(self, waiting: list[NumberedRows]) -> None:
        with self._more:
            for rows in waiting:
                self._waiting[TABLE_OF[type(rows.batch)].name] -= len(rows.batch)


def _single(rows: NumberedRows) -> bool:
    """Return true if rows belong to a single-file table."""
    return not TABLE_OF[type(rows.batch)].parted


def delete_journal(folder: Path) -> None:
    """Delete the journal of a session: all its rows are in parts.

    Raises:
        OSError: some of it is left.
    """
    journal = folder / JOURNAL
    for path in [*segments(folder).values(), single_log(folder), *journal.glob("*" + SCRATCH)]:
        steps.reach("delete segment")
        path.unlink(missing_ok=True)
    steps.reach("delete journal")
    journal.rmdir()
    sync(folder)

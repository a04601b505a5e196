"""The journal of a session: its rows on their way to Parquet, so that a crash costs only the last."""

from collections import Counter
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from threading import Condition, Event, RLock, Thread
from typing import Final

from storage import frames, steps
from storage.files import SCRATCH, make_folder, sync
from storage.frames import Rows
from storage.layout import JOURNAL, TABLE_OF, segment_file, segments, single_log
from storage.segment import OpenSegment

SOON: Final = 5  # rows of a table that wait, at which they are appended
MOST: Final = 10  # rows of a table that may wait: what a kill can cost
PAUSE: Final = 0.05  # s that a row waits at most
SYNC: Final = 1.0  # s, after which what was appended is made durable


class Journal:
    """The segments of one session and the two threads that write them: one appends, one makes durable.

    A slow fsync does not hold up what is appended meanwhile. Only `add` may be called by who must not wait.
    Rows of tables of one file, written when the session ends, have a segment of their own until then.
    """

    def __init__(self, folder: Path, session: str) -> None:
        """Begin the journal in a session's folder.

        Args:
            folder: The session's.
            session: Its name.

        Raises:
            OSError: if it cannot be written.
        """
        self._folder, self._session = folder, session
        make_folder(folder / JOURNAL)
        self._single = OpenSegment(single_log(folder), session, frames.SINGLE_LOG)  # there before all others
        self._segment = OpenSegment(folder / segment_file(0), session, 0)
        self._disk = RLock()  # held while frames are appended
        self._syncing = RLock()  # held while the segment is made durable; taken before _disk
        self._more = Condition()  # guards what follows; never held while the disk works
        self._pending: list[Rows] = []
        self._waiting = Counter[str]()  # rows by table, those that are just being appended included
        self._failing, self._ended = False, False
        self.suspect = False  # an fsync failed: what it was about may be lost, and only a commit can tell
        self._end = Event()
        self._threads = [Thread(target=each, daemon=True) for each in (self._append_soon, self._sync_often)]
        for thread in self._threads:
            thread.start()

    def add(self, rows: Rows) -> bool:
        """Have rows appended soon; False: not taken, since too many wait or the disk fails."""
        table = TABLE_OF[type(rows.batch)].name
        with self._more:
            waiting = self._waiting[table] + len(rows.batch)
            if waiting > MOST or self._failing or self._ended:
                return False
            self._waiting[table] = waiting
            self._pending.append(rows)
            if waiting >= SOON:
                self._more.notify()
        return True

    @contextmanager
    def held(self) -> Generator[None]:
        """Nothing else is appended, and no segment begun, meanwhile."""
        with self._disk:
            yield

    def append(self, *rows: Rows) -> None:
        """Append what waits and then `rows`, which are of one table, now.

        Raises:
            OSError: nothing was; what waits goes on waiting, `rows` do not.
        """
        with self._disk:
            waiting = self._take()
            if not waiting and not rows:
                return
            try:
                single = any(map(_single, rows))
                for of_single in (not single, single):  # `rows` last: if that fails, they are nowhere
                    self._write([each for each in chain(waiting, rows) if _single(each) is of_single])
            except BaseException:
                self._give_back(waiting)
                self._failing = True
                raise
            self._failing = False
            self._appended(waiting)

    def rotate(self, kept: Callable[[], Iterable[Rows]], single: Callable[[], Iterable[Rows]]) -> None:
        """Begin the next segment with the rows that stay in memory: the others are to be committed.

        Args:
            kept: Gives those of tables of parts.
            single: Gives all rows of tables of one file, which are written again only if an fsync failed.

        Raises:
            OSError: the segment is still the one that it was.
        """
        number = self._segment.number + 1
        fresh = OpenSegment(self._folder / segment_file(number), self._session, number)
        with self._syncing:
            with self._disk:
                waiting = self._take()  # some are to be committed, but are in no part yet
                try:  # in order; some are there twice, which their numbers tell
                    of_parts = [*(each for each in waiting if not _single(each)), *kept()]
                    fresh.append(frames.bodies(sorted(of_parts, key=lambda rows: rows.first)))
                    self._go_on(waiting, single)
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
        """Make durable what was appended.

        Raises:
            OSError: some of it may never become so: it is suspect until the next segment begins.
        """
        with self._syncing:
            try:
                self._single.sync()
                self._segment.sync()
            except OSError:
                # trying again could seem to work: the kernel may have forgotten what it did not write
                self.suspect = True
                raise

    def drop(self) -> None:
        """Delete the segments before this one: their rows are in parts, or in this one.

        Raises:
            OSError: some are left.
        """
        self.sync()
        for number, path in segments(self._folder).items():
            if number < self._segment.number:
                steps.reach("drop segment")
                path.unlink(missing_ok=True)
        sync(self._folder / JOURNAL)

    def stop(self) -> None:
        """End the threads, and append what waits and what is new, if the disk lets; may be called again."""
        with self._more:
            self._ended = True
            self._more.notify()
        self._end.set()
        for thread in self._threads:
            thread.join()
        with suppress(OSError):
            self.append()

    def remove(self) -> None:
        """Delete the journal, which has been stopped: all its rows are in parts.

        Raises:
            OSError: some of it is left.
        """
        self._close()
        drop_journal(self._folder)

    def leave(self) -> None:
        """Let go of the journal as it is; may be called again."""
        self.stop()
        self._close()

    def _close(self) -> None:
        self._segment.close()
        self._single.close()

    def _write(self, rows: list[Rows]) -> None:
        """Append rows that belong to one segment."""
        if rows:
            (self._single if _single(rows[0]) else self._segment).append(frames.bodies(rows))

    def _go_on(self, waiting: list[Rows], single: Callable[[], Iterable[Rows]]) -> None:
        """Have the rows of tables of one file in a segment that is not suspect."""
        if self.suspect:
            bodies = frames.bodies(single())
            fresh = OpenSegment(self._single.path, self._session, frames.SINGLE_LOG, bodies)
            self._single.close()
            self._single = fresh
        else:
            self._write([each for each in waiting if _single(each)])

    def _append_soon(self) -> None:
        while True:
            with self._more:
                if self._failing or max(self._waiting.values(), default=0) < SOON:
                    self._more.wait(PAUSE)
                if self._ended:
                    return
            with suppress(OSError):  # whoever writes next meets it again
                self.append()

    def _sync_often(self) -> None:
        while not self._end.wait(SYNC):
            with suppress(OSError):  # then it is suspect
                self.sync()

    def _take(self) -> list[Rows]:
        with self._more:
            waiting, self._pending = self._pending, []
        return waiting

    def _give_back(self, waiting: list[Rows]) -> None:
        with self._more:
            self._pending[:0] = waiting

    def _appended(self, waiting: list[Rows]) -> None:
        with self._more:
            for rows in waiting:
                self._waiting[TABLE_OF[type(rows.batch)].name] -= len(rows.batch)


def _single(rows: Rows) -> bool:
    """Whether rows are of a table of one file."""
    return not TABLE_OF[type(rows.batch)].parted


def drop_journal(folder: Path) -> None:
    """Delete the journal of a session: all that it held is in parts.

    Raises:
        OSError: some of it is left.
    """
    place = folder / JOURNAL
    for path in [
        *segments(folder).values(),
        single_log(folder),
        *place.glob("*" + SCRATCH),
    ]:
        steps.reach("drop segment")
        path.unlink(missing_ok=True)
    steps.reach("drop journal")
    place.rmdir()
    sync(folder)

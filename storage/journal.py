"""The journal of a session: its rows on their way to Parquet, so that a crash costs only the last."""

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from threading import Condition, Event, RLock, Thread
from typing import Final

from storage import frames, steps
from storage.files import SCRATCH, make_folder, sync
from storage.frames import Rows
from storage.layout import JOURNAL, TABLE_OF, segment_file, segments
from storage.segment import OpenSegment

SOON: Final = 5  # rows of a table that wait, at which they are appended
MOST: Final = 10  # rows of a table that may wait: what a kill can cost
PAUSE: Final = 0.05  # s that a row waits at most
SYNC: Final = 1.0  # s, after which what was appended is made durable


class Journal:
    """The segments of one session and the two threads that write them: one appends, one makes durable.

    A slow fsync does not hold up what is appended meanwhile. Only `add` may be called by who must not wait.
    """

    def __init__(self, folder: Path, session: str, told: Callable[[], bytes | None]) -> None:
        """Begin the journal in a session's folder.

        Args:
            folder: The session's.
            session: Its name.
            told: Gives the body of the frame that tells of the episodes so far; None: not now.

        Raises:
            OSError: if it cannot be written.
        """
        self._folder, self._session, self._told = folder, session, told
        make_folder(folder / JOURNAL)
        self._segment = OpenSegment(folder / segment_file(0), session, 0)
        self._last_told: bytes | None = None
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
        """Append what waits and then `rows`, now.

        Raises:
            OSError: nothing was; what waits goes on waiting, `rows` do not.
        """
        with self._disk:
            waiting = self._take()
            if not waiting and not rows:
                return
            try:
                self._segment.append(_bodies(chain(waiting, rows)))
            except BaseException:
                self._give_back(waiting)
                self._failing = True
                raise
            self._failing = False
            self._appended(waiting)

    def rotate(self, kept: Callable[[], Iterable[Rows]]) -> None:
        """Begin the next segment with the rows that stay in memory: the others are to be committed.

        Raises:
            OSError: the segment is still the one that it was.
        """
        number = self._segment.number + 1
        fresh = OpenSegment(self._folder / segment_file(number), self._session, number)
        with self._syncing:
            with self._disk:
                waiting = self._take()  # some are to be committed, but are in no part yet
                try:  # in order; some are there twice, which their numbers tell
                    fresh.append(_bodies(sorted([*waiting, *kept()], key=lambda rows: rows.first)))
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

    def drop(self) -> None:
        """Delete the segments before this one: their rows are in parts, or in this one.

        Raises:
            OSError: some are left.
        """
        with self._syncing:
            self._segment.sync()
        for number, path in segments(self._folder).items():
            if number < self._segment.number:
                steps.reach("drop segment")
                path.unlink(missing_ok=True)
        sync(self._folder / JOURNAL)

    def stop(self) -> None:
        """End the threads, and append what waits and was not told, if the disk lets; may be called again."""
        with self._more:
            self._ended = True
            self._more.notify()
        self._end.set()
        for thread in self._threads:
            thread.join()
        with suppress(OSError):
            self.append()
            self._tell()

    def remove(self) -> None:
        """Delete the journal, which has been stopped: all its rows are in parts.

        Raises:
            OSError: some of it is left.
        """
        self._segment.close()
        drop_journal(self._folder)

    def leave(self) -> None:
        """Let go of the journal as it is; may be called again."""
        self.stop()
        self._segment.close()

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
            with suppress(OSError):  # as above
                self._tell()
            try:
                with self._syncing:
                    self._segment.sync()
            except (
                OSError
            ):  # trying again could seem to work: the kernel may have forgotten what it did not write
                self.suspect = True

    def _tell(self) -> None:
        """Append the episodes if there are others than the last time."""
        told = self._told()
        if told is not None and told != self._last_told:
            with self._disk:
                self._segment.append([told])
            self._last_told = told

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


def drop_journal(folder: Path) -> None:
    """Delete the journal of a session: all that it held is in parts.

    Raises:
        OSError: some of it is left.
    """
    place = folder / JOURNAL
    for path in [*segments(folder).values(), *place.glob("*" + SCRATCH)]:
        steps.reach("drop segment")
        path.unlink(missing_ok=True)
    steps.reach("drop journal")
    place.rmdir()
    sync(folder)


def _bodies(rows: Iterable[Rows]) -> Iterator[bytes]:
    return chain.from_iterable(map(frames.bodies, rows))

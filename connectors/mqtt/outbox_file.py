"""Numbered slip events in a SQLite file; `connectors.mqtt.outbox.Outbox` calls it in a thread.

Every row has a checksum, because SQLite does not detect flipped bits. A damaged file is renamed and its
intact rows are copied to a new one. Written rows survive a crash of the process, and a power cut once they
are synced.
"""

import errno
import logging
import os
import sqlite3
import time
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass
from pathlib import Path
from threading import Lock
from zlib import crc32

from operators.errors import InputError, os_error_reason

log = logging.getLogger("slipflow")

FORMAT = 1
EPOCHS_KEPT = 12  # newest epochs, kept even if they have no events
PRUNE_MAX = 1000  # rows per call, so that live events are not delayed
LOG_PAGES = 10_000  # pages of the write-ahead log before a write has to wait for a checkpoint
_LOG_HEADER, _FRAME_HEADER = 32, 24  # bytes, https://www.sqlite.org/fileformat2.html section 4
_TABLES = f"""
BEGIN;
CREATE TABLE epochs (name TEXT PRIMARY KEY, base INTEGER, last INTEGER, sent INTEGER, boot TEXT,
    crc INTEGER);
CREATE TABLE events (id INTEGER PRIMARY KEY, epoch TEXT, seq INTEGER, finger TEXT, payload BLOB, made INTEGER,
    crc INTEGER, waits INTEGER);
CREATE INDEX waiting ON events (id) WHERE waits = 1;
PRAGMA user_version = {FORMAT};
COMMIT;
"""
_ENTRY = "id, epoch, seq, finger, payload, made, crc"
_DAMAGE = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, sqlite3.SQLITE_FORMAT}
_RIGHTS = "; give this user write access to its folder, or name another file"
_REMEDIES = {
    sqlite3.SQLITE_FULL: "; free disk space, or name another file",
    sqlite3.SQLITE_CANTOPEN: _RIGHTS,
    sqlite3.SQLITE_READONLY: _RIGHTS,
}


@dataclass(frozen=True, slots=True)
class Entry:
    """An event in the outbox."""

    id: int  # unique over all epochs, in chronological order
    epoch: str
    seq: int
    finger: str
    payload: bytes
    made: int  # s since 1970-01-01 UTC

    def row(self) -> tuple[object, ...]:
        """Return the values of the row and their checksum."""
        values = self.id, self.epoch, self.seq, self.finger, self.payload, self.made
        return *values, crc32(self.payload, crc32(repr((*values[:4], self.made)).encode()))


@dataclass(slots=True)
class Epoch:
    """A series of numbers; event `seq` has the id ``base + seq``."""

    name: str
    base: int
    last: int = 0  # newest number
    sent: int = 0  # newest acknowledged number
    boot: str = ""  # boot in which the epoch was in use; empty: closed, no number is lost

    def row(self) -> tuple[object, ...]:
        """Return the values of the row and their checksum."""
        values = astuple(self)
        return *values, crc32(repr(values).encode())


class Damaged(Exception):  # noqa: N818 - `Outbox` converts it
    """Damage of the file: its content is not what was written."""


class OutboxFile:
    """An open outbox file; every call blocks and may raise sqlite3.Error or OSError."""

    def __init__(self, path: Path) -> None:
        """Open or create `path`; rename a damaged file and start a new one with its intact rows.

        Raises:
            InputError: if the file is not an outbox, or one of another format.
        """
        self.path = path
        self.epochs: list[Epoch] = []  # as found, oldest first
        self.renewed = False  # True: numbers may be missing, so start a new epoch
        self._log: int | None = None  # descriptor of the write-ahead log
        self._syncing = Lock()  # held while the descriptor is used or closed
        try:
            self._open()
        except Damaged as damage:
            self._set_aside(str(damage))
        [(self.highest,)] = self._db.execute("SELECT coalesce(max(id), 0) FROM events")
        self.highest = max([self.highest, *(epoch.base + epoch.last for epoch in self.epochs)])
        [(self.waiting,)] = self._db.execute("SELECT count(*) FROM events WHERE waits = 1")

    def append(
        self, entries: Iterable[tuple[Entry, bool]], epochs: Sequence[Epoch], forget: Iterable[int] = ()
    ) -> None:
        """Write entries, each with True if it is unsent; first delete the ids in `forget`."""
        with self._transaction():
            self._db.executemany("DELETE FROM events WHERE id = ?", ((entry,) for entry in forget))
            rows = ((*entry.row(), int(waits)) for entry, waits in entries)
            self._db.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?, ?)", rows)
            self._write_epochs(epochs)

    def acknowledge(self, ids: Iterable[tuple[int, int]], epochs: Sequence[Epoch]) -> None:
        """Mark ranges of ids as sent; a power cut may undo the newest marks."""
        with self._transaction():
            done = "UPDATE events SET waits = 0 WHERE waits = 1 AND id BETWEEN ? AND ?"
            self._db.executemany(done, ids)
            self._write_epochs(epochs)

    def mark(self, epochs: Sequence[Epoch]) -> None:
        """Write the state of the epochs, and make it and all earlier writes durable."""
        self._db.execute("PRAGMA synchronous = FULL")
        try:
            self.append((), epochs)
        finally:
            self._db.execute("PRAGMA synchronous = NORMAL")

    def sync(self) -> None:
        """Make all writes durable; unlike the other methods, call it in a second thread."""
        with self._syncing:
            if self._log is None:
                self._log = os.open(f"{self.path}-wal", os.O_RDONLY | os.O_CLOEXEC)
            os.fdatasync(self._log)

    def checkpoint(self) -> None:
        """Copy the write-ahead log into the file."""
        self._db.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()

    def prune(self, count: int, oldest: float) -> None:
        """Delete sent entries beyond the newest `count` or older than `oldest` (s since 1970)."""
        expired = "SELECT id FROM events WHERE waits = 0 AND (id <= ? OR made < ?) ORDER BY id LIMIT ?"
        with self._transaction():
            [(newest,)] = self._db.execute("SELECT coalesce(max(id), 0) FROM events")
            limits = newest - count, oldest, PRUNE_MAX
            self._db.execute(f"DELETE FROM events WHERE id IN ({expired})", limits)  # noqa: S608 - ours
            found = "SELECT name FROM epochs ORDER BY base DESC, rowid DESC LIMIT -1 OFFSET ?"
            used = "SELECT 1 FROM events WHERE id BETWEEN base + 1 AND base + last"
            unused = f"DELETE FROM epochs WHERE name IN ({found}) AND NOT EXISTS ({used})"  # noqa: S608 - ours
            self._db.execute(unused, (EPOCHS_KEPT,))

    def waiting_after(self, after: int, limit: int) -> list[Entry]:
        """Return the next unsent entries after id `after`."""
        return self._entries("waits = 1 AND id > ?", (after,), limit)

    def between(self, epoch: Epoch, first: int, last: int, limit: int) -> list[Entry]:
        """Return up to `limit` entries of an epoch from number `first` to `last`, in order."""
        ids = epoch.base + first, epoch.base + last
        return self._entries("epoch = ? AND id BETWEEN ? AND ?", (epoch.name, *ids), limit)

    def close(self) -> None:
        """Close the file."""
        with self._syncing:
            if self._log is not None:
                os.close(self._log)
            self._log = None
        self._db.close()

    def _entries(self, condition: str, values: tuple[object, ...], limit: int) -> list[Entry]:
        query = f"SELECT {_ENTRY} FROM events WHERE {condition} ORDER BY id LIMIT ?"  # noqa: S608 - ours
        return [_entry(row) for row in self._db.execute(query, (*values, limit))]

    def _write_epochs(self, epochs: Sequence[Epoch]) -> None:
        rows = [epoch.row() for epoch in epochs]
        self._db.executemany("INSERT OR REPLACE INTO epochs VALUES (?, ?, ?, ?, ?, ?)", rows)

    @contextmanager
    def _transaction(self) -> Generator[None]:
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):  # SQLite may have rolled back by itself
                self._db.execute("ROLLBACK")
            raise

    def _open(self) -> None:
        log_size = _size(f"{self.path}-wal")
        self._db = sqlite3.connect(self.path, timeout=0, isolation_level=None, check_same_thread=False)
        try:
            self._prepare()
            self._check(log_size)
        except sqlite3.Error as error:
            self._db.close()
            marked_read_only = _code(error) == sqlite3.SQLITE_READONLY and os.access(self.path, os.W_OK)
            if marked_read_only or _code(error) in _DAMAGE:
                raise Damaged(str(error)) from None
            raise
        except BaseException:
            self._db.close()
            raise

    def _prepare(self) -> None:
        self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
        self._db.execute("PRAGMA synchronous = NORMAL")  # events do not wait for the disk, see `sync`
        self._db.execute(f"PRAGMA wal_autocheckpoint = {LOG_PAGES}")
        [(version,)] = self._db.execute("PRAGMA user_version")
        [(objects,)] = self._db.execute("SELECT count(*) FROM sqlite_schema")
        if version != FORMAT and (version or objects):
            found = f"has outbox format {version}" if version else "is not an outbox"
            raise InputError(str(self.path), f"{found}: name another file, or move it away")
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA journal_size_limit = 0")  # a checkpoint leaves no old frames in the log
        if not objects:
            self._db.executescript(_TABLES)

    def _check(self, log_size: int) -> None:
        [(_, frames, _)] = self._db.execute("PRAGMA wal_checkpoint(PASSIVE)")
        [(page_size,)] = self._db.execute("PRAGMA page_size")
        if frames < (log_size - _LOG_HEADER) // (page_size + _FRAME_HEADER):
            # SQLite silently ends its recovery at a bad checksum: an unfinished write, or flipped bits
            log.warning("%s: ignoring an incomplete or damaged write; starting a new epoch", self.path)
            self.renewed = True
        [(verdict,)] = self._db.execute("PRAGMA integrity_check(1)").fetchmany(1)
        if verdict != "ok":
            raise Damaged(str(verdict))
        epochs = {epoch.name: epoch for epoch in _epochs(self._db)}
        for *row, waits in self._db.execute(f"SELECT {_ENTRY}, waits FROM events"):  # noqa: S608 - ours
            entry = _entry(row)
            if waits not in (0, 1) or entry.epoch not in epochs:
                raise Damaged("a row has a wrong checksum")
            epoch = epochs[entry.epoch]
            epoch.last = max(epoch.last, entry.seq)  # the epoch's row may be one write older
        self.epochs = list(epochs.values())

    def _set_aside(self, damage: str) -> None:
        """Rename the file and copy its intact rows to a new one."""
        aside = Path(f"{self.path}.damaged-{time.strftime('%Y%m%dT%H%M%S')}-{time.time_ns() % 10**9:09}")
        for part in ("", "-wal", "-shm"):
            with suppress(FileNotFoundError):
                Path(f"{self.path}{part}").rename(f"{aside}{part}")
        rows, epochs = _read_intact(aside)
        self._open()
        for entry, waits in rows:
            epoch = epochs.setdefault(entry.epoch, Epoch(entry.epoch, entry.id - entry.seq))
            epoch.last = max(epoch.last, entry.seq)
            epoch.sent = epoch.sent if waits else max(epoch.sent, entry.seq)
        self.epochs, self.renewed = sorted(epochs.values(), key=lambda epoch: epoch.base), True
        self.append(rows, self.epochs)
        text = "%s: damaged (%s); renamed to %s; copied %d intact events, %d of them unsent"
        log.error(text, self.path, damage, aside.name, len(rows), sum(waits for _, waits in rows))


def is_full(error: BaseException | None) -> bool:
    """Return True if the disk is full."""
    if isinstance(error, sqlite3.Error):
        return _code(error) == sqlite3.SQLITE_FULL
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def reason_of(error: Exception) -> str:
    """Return the reason of an error, with a remedy if one is known."""
    if isinstance(error, sqlite3.Error):
        return f"{error}{_REMEDIES.get(_code(error), '')}"
    return os_error_reason(error) if isinstance(error, OSError) else str(error)


def _size(path: str) -> int:
    try:
        return os.stat(path).st_size  # noqa: PTH116 - the path is a string
    except FileNotFoundError:
        return 0


def _code(error: sqlite3.Error) -> int:
    # errors of undecodable text have no code
    code: int = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
    return code & 0xFF


def _entry(row: Sequence[object]) -> Entry:
    number, epoch, seq, finger, payload, made, _ = row
    if (
        isinstance(number, int)
        and isinstance(epoch, str)
        and isinstance(seq, int)
        and isinstance(finger, str)
        and isinstance(payload, bytes)
        and isinstance(made, int)
    ):
        entry = Entry(number, epoch, seq, finger, payload, made)
        if entry.row() == tuple(row):
            return entry
    raise Damaged("a row has a wrong checksum")


def _epochs(db: sqlite3.Connection) -> list[Epoch]:
    found = list[Epoch]()
    for *values, crc in db.execute("SELECT * FROM epochs ORDER BY base, rowid"):
        epoch = Epoch(*values)
        if epoch.row() != (*values, crc):
            raise Damaged("a row has a wrong checksum")
        found.append(epoch)
    return found


def _read_intact(path: Path) -> tuple[list[tuple[Entry, bool]], dict[str, Epoch]]:
    """Read the intact rows of a damaged file from both ends; unknown flags count as unsent."""
    found, epochs = dict[int, tuple[Entry, bool]](), dict[str, Epoch]()
    with suppress(sqlite3.Error):
        db = sqlite3.connect(path, timeout=0, isolation_level=None)
        for order in ("ASC", "DESC"):
            query = f"SELECT {_ENTRY}, waits FROM events ORDER BY id {order}"  # noqa: S608 - ours
            with suppress(sqlite3.Error):
                for *row, waits in db.execute(query):
                    with suppress(Damaged):
                        entry = _entry(row)
                        found[entry.id] = entry, waits != 0
        with suppress(sqlite3.Error, Damaged):
            epochs = {epoch.name: epoch for epoch in _epochs(db)}
        db.close()
    return [found[number] for number in sorted(found)], epochs

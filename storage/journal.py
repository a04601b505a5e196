"""Journal of a session: rows that are not in a part yet, in append-only logs.

.. code-block:: text

    journal/000000.wal  segment; numbered on
    identity            JSON: version, session, number of the segment, sha256 of the columns of all tables
    record              code of the batch type (1), finger (2), cells (4), rows (4), number of the first in
                        its table (8); the packed rows

A segment begins with all rows of single-file tables so far, which are in no file until the session ends.
All numbers are little-endian and, except for the finger, unsigned. See `storage.append_log` for the file.
"""

import json
from collections import Counter, deque
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from struct import Struct
from sys import byteorder
from typing import Any, Final, NamedTuple

import numpy as np

from operators.batch import Batch, columns, packed_type
from operators.errors import InputError
from operators.fingertip import CELL_LIMIT
from storage import files
from storage.append_log import LIMIT, AppendLog, LogReader
from storage.layout import JOURNAL, SEGMENTS, TABLE_OF, file_name, numbered_files

VERSION: Final = 7  # of identity and records; other versions refuse the segment
APPEND_AT: Final = 5  # waiting rows of a table from which they should be appended at once
MAX_WAITING: Final = 10  # rows of a table that may wait; a kill loses them

_HEAD: Final = Struct("<BhIIQ")
_KINDS: Final = tuple(TABLE_OF)  # the code of a record is the index of its batch type
_CODES: Final = {kind: code for code, kind in enumerate(_KINDS)}
_MOVE: Final = "; move it away to recover the rest"


class NumberedRows(NamedTuple):
    """Rows of one batch, and the number of the first within its table."""

    first: int
    batch: Batch


class Buffer:
    """Rows of one table that are in no part yet, packed, with at most an eighth of spare capacity.

    Attributes:
        kind: Type of all batches of this session.
        cells: Number of cells of their fingertip; 0 if they have no column per cell.
        start: Number of the first row within the table.
        rows: Number of rows.
        first: Earliest event time, ns.
        last: Latest event time, ns.

    >>> from operators.batch import Slips
    >>> buffer = Buffer(Slips)
    >>> for finger in (0, 0, 1):
    ...     buffer.add(Slips.rows([7], 1, 7, 0.5, finger=finger))
    >>> [(first, batch.finger, len(batch)) for first, batch in buffer.numbered()]
    [(0, 0, 2), (2, 1, 1)]
    """

    def __init__(self, kind: type[Batch], start: int = 0, cells: int = 0) -> None:
        self.kind, self.start, self.cells = kind, start, cells
        self.rows = self.first = self.last = 0
        self._rows, self._fingers = bytearray(), bytearray()

    @property
    def end(self) -> int:
        """Number of the next row."""
        return self.start + self.rows

    def add(self, batch: Batch) -> None:
        """Add the rows of a batch that is not empty, all or none."""
        rows, fingers = batch.packed.tobytes(), batch.finger.to_bytes(2, byteorder, signed=True) * len(batch)
        self.rows, self.first, self.last = self.extent_with(batch)
        self._rows += rows
        self._fingers += fingers

    def extent_with(self, batch: Batch) -> tuple[int, int, int]:
        """Return the row count, first and last time if `batch` were added."""
        time = batch.time
        first, last = (time.item(),) * 2 if len(time) == 1 else (time.min().item(), time.max().item())
        if not self.rows:
            return len(time), first, last
        return self.rows + len(time), min(self.first, first), max(self.last, last)

    def batches(self) -> list[Batch]:
        """Return the rows in order of arrival, consecutive rows of a fingertip as one batch."""
        fingers = np.frombuffer(bytes(self._fingers), np.int16)  # (n,)
        rows = np.frombuffer(bytes(self._rows), packed_type(self.kind, self.cells))
        changes = np.flatnonzero(np.diff(fingers)) + 1
        edges: list[int] = [0, *changes.tolist(), self.rows] if self.rows else []
        return [self.kind.unpack(rows[first:end], int(fingers[first])) for first, end in pairwise(edges)]

    def numbered(self) -> list[NumberedRows]:
        """Return the same batches, each with the number of its first row."""
        numbered, first = list[NumberedRows](), self.start
        for batch in self.batches():
            numbered.append(NumberedRows(first, batch))
            first += len(batch)
        return numbered


class Journal:
    """Journal of a session that is being recorded. Only `add` never waits for the disk.

    `add` may run in a different thread from the rest. `append`, `sync` and a commit, which ends with
    `rotate`, may run at the same time, each once.
    """

    def __init__(self, folder: Path, session: str) -> None:
        self._folder, self._session = folder, session
        files.make_folder(folder / JOURNAL)
        self._segments = [self._create(0)]  # the last one gets the rows
        self._next = 1  # number of the next segment
        self._committing: list[AppendLog] = []  # that are deleted after the commit
        self._restarting = False  # these are all segments, because some of them are suspect
        self._waiting = deque[NumberedRows]()
        self._added, self._appended = Counter[type[Batch]](), Counter[type[Batch]]()  # rows by type

    @property
    def waiting(self) -> int:
        """Largest number of rows of a table that are not appended yet."""
        return max((rows - self._appended[kind] for kind, rows in self._added.items()), default=0)

    @property
    def pending(self) -> int:
        """Rows that are not appended yet."""
        return sum(rows - self._appended[kind] for kind, rows in self._added.items())

    @property
    def suspect(self) -> bool:
        """True if appended rows may be lost, or no more can be appended: a commit replaces all segments."""
        return any(log.suspect for log in self._segments)

    @property
    def unsynced(self) -> bool:
        """True if `sync` has rows to make durable."""
        return not self.suspect and any(log.unsynced for log in self._segments)

    def add(self, rows: NumberedRows) -> bool:
        """Queue rows; return false if too many wait, and they were not queued."""
        kind, count = type(rows.batch), len(rows.batch)
        if self._added[kind] - self._appended[kind] + count > MAX_WAITING:
            return False
        self._added[kind] += count
        self._waiting.append(rows)
        return True

    def append(self, *rows: NumberedRows) -> None:
        """Append the waiting rows, then `rows`.

        Raises:
            OSError: nothing was appended; the waiting rows stay queued, `rows` do not.
        """
        waiting = [self._waiting.popleft() for _ in range(len(self._waiting))]
        try:
            self._segments[-1].append(encode([*waiting, *rows]))
        except BaseException:
            self._waiting.extendleft(reversed(waiting))
            raise
        for found in waiting:
            self._appended[type(found.batch)] += len(found.batch)

    def sync(self) -> None:
        """Make the appended rows durable.

        Raises:
            OSError: some rows may be lost; the journal is `suspect`.
        """
        for log in self._segments:
            log.sync()

    def begin_commit(self) -> None:
        """Note that all rows so far are about to be committed; a `suspect` journal may get none meanwhile."""
        self._restarting = self.suspect
        self._committing = self._segments[:] if self._restarting else self._segments[:-1]

    def rotate(self, single: Iterable[NumberedRows]) -> None:
        """Begin the next segment, and delete those whose rows of multi-part tables are committed now.

        The segment before it stays: rows may have been added to it since `begin_commit`. `single` has all
        rows of single-file tables at that time.

        Raises:
            OSError: it may be called again.
        """
        self._segments.append(self._create(self._next, single))
        self._next += 1
        if self._restarting:
            self._waiting.clear()
            self._appended = self._added.copy()
        self._segments = [each for each in self._segments if each not in self._committing]
        while self._committing:
            self._committing[-1].close()
            self._committing[-1].path.unlink(missing_ok=True)
            self._committing.pop()
        if self._restarting:
            files.sync(self._folder / JOURNAL)

    def close(self) -> None:
        """Close the journal without deleting it; may be called again."""
        for log in self._segments:
            log.close()

    def _create(self, number: int, rows: Iterable[NumberedRows] = ()) -> AppendLog:
        path = self._folder / file_name(SEGMENTS, number)
        return AppendLog(path, identity(self._session, number), encode(rows))


def journal_files(folder: Path) -> list[Path]:
    """Return the files of a session's journal, also incomplete ones; other files may lie next to them."""
    patterns = SEGMENTS, SEGMENTS + files.SCRATCH
    return [path for each in patterns for path in numbered_files(folder, each).values()]


def delete_journal(folder: Path) -> None:
    """Delete the journal of a session, whose rows must be in parts; files that are not of it stay."""
    for path in journal_files(folder):
        path.unlink(missing_ok=True)
    if not any((folder / JOURNAL).iterdir()):
        (folder / JOURNAL).rmdir()
    files.sync(folder)


def identity(session: str, number: int) -> bytes:
    """Return the identity of a segment."""
    about = {"version": VERSION, "session": session, "segment": number, "columns": _columns_sha256()}
    return json.dumps(about).encode()


def encode(rows: Iterable[NumberedRows]) -> list[bytes]:
    """Return the records of rows: one for each batch, or several if it is too large for one."""
    records = list[bytes]()
    for first, batch in rows:
        most = (LIMIT - _HEAD.size) // batch.packed.itemsize
        for start in range(0, len(batch), most):
            part = batch.packed[start : start + most]
            head = _HEAD.pack(_CODES[type(batch)], batch.finger, batch.cells, len(part), first + start)
            records.append(head + part.tobytes())
    return records


def decode(record: bytes, where: str) -> NumberedRows:
    """Return the rows of a record.

    Raises:
        InputError: if it is invalid.
    """
    code, finger, cells, count, first = _HEAD.unpack(record[: _HEAD.size].ljust(_HEAD.size, b"\xff"))
    kind = _KINDS[code] if code < len(_KINDS) else None
    row = packed_type(kind, cells) if kind and cells <= CELL_LIMIT else None
    if kind is None or row is None or len(record) != _HEAD.size + count * row.itemsize:
        raise InputError(where, f"has an invalid record{_MOVE}")
    rows = np.frombuffer(record, row, count, _HEAD.size)
    for name, each in columns(kind).items():
        known = not each.names or np.isin(rows[name], np.arange(len(each.names))).all()
        if not known or 0 in rows[name].shape[1:]:  # a code without a name, or no cell
            raise InputError(where, f"has an invalid record{_MOVE}")
    return NumberedRows(first, kind.unpack(rows, finger))


def check_segment(log: LogReader, session: str, number: int) -> None:
    """Check that a log is the segment of this number, of this session, with the columns that are known.

    Raises:
        InputError: if it is not; nothing is known of one whose header is damaged.
    """
    if log.damage:
        return
    where = str(log.path)
    try:
        about: dict[str, Any] = dict(json.loads(log.identity))
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(where, f"has an invalid description{_MOVE}: {error!r}") from error
    expected = json.loads(identity(session, number))
    if about.get("version") != VERSION or about.get("columns") != expected["columns"]:
        reason = f"has version {about.get('version')!r} or other columns; this slipflow reads {VERSION}"
        raise InputError(where, f"{reason}: recover it with the software named in session.json")
    if about != expected:
        own = f"segment {about.get('segment')!r} of session {about.get('session')!r}"
        raise InputError(where, f"is {own}; move it back there")


@cache
def _columns_sha256() -> str:
    """Return the sha256 of name, element type with byte order, shape and code names of all columns."""
    found = [
        [kind.__name__, name, each.dtype.str, [*each.shape], [*each.names]]
        for kind in _KINDS
        for name, each in columns(kind).items()
    ]
    return sha256(json.dumps(found).encode()).hexdigest()

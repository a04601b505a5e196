"""Segment files of a journal: rows as checksummed frames, each appended completely or not at all.

.. code-block:: text

    segment   "SLIPWAL1", 8 random bytes; then frames, the first of which describes the segment as JSON
    frame     "SLIP", length of the body (4 bytes), CRC-32 (4 bytes); body
    body      code (1), finger (2), rows (4), number of the first in its table (8); the columns, end to end
    CRC-32    zlib's, of these, end to end: the 16 bytes with which the segment begins; the frame's offset in
              the file (8); length of the body (4); the body

All numbers are little-endian and, except for the finger, unsigned. The CRC covers segment and offset, so a
stale frame, such as one of an older file whose blocks were reused, is never valid, nor is a tail of zeros
or a repeated one.
"""

import json
import math
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from struct import Struct
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from operators.batch import Batch, columns
from operators.errors import InputError
from storage import files, steps
from storage.layout import TABLE_OF

VERSION: Final = 3  # of the bodies; other versions refuse the segment
SINGLE_LOG: Final = -1  # number of the segment with the rows of single-file tables
LIMIT: Final = 64 * files.MiB  # bytes of a body
WHOLE: Final = 8192 * files.MiB  # bytes of a segment

# Change the digit when the layout of segments or frames changes. Other versions then report the segment as
# damaged from its first byte, and a recovery moves it to `damaged`.
_PREAMBLE: Final = b"SLIPWAL1"
_MAGIC: Final = b"SLIP"
_PREFIX: Final = Struct("<4sII")
_HEAD: Final = Struct("<BhIQ")
_POSITION: Final = Struct("<QI")
_KINDS: Final = tuple(TABLE_OF)  # the code of a frame is the index of its batch type
_CODES: Final = {kind: code for code, kind in enumerate(_KINDS)}
_ROW_SIZES: Final = {  # bytes
    kind: sum(each.dtype.itemsize * math.prod(each.shape) for each in columns(kind).values())
    for kind in _KINDS
}
_DESCRIPTION: Final = 255  # code of a frame with JSON
_SEARCHED: Final = 256 * files.MiB  # bytes; most that are hashed to find whole frames after damage
_MOVE: Final = "; move it away to recover the rest"
SALT_SIZE: Final = len(_PREAMBLE) + 8  # bytes at the start of a segment


class NumberedRows(NamedTuple):
    """Rows of one batch, and the number of the first within its table."""

    first: int
    batch: Batch


@dataclass(frozen=True)
class Damage:
    """Position from which a segment cannot be read."""

    offset: int  # bytes, of the first frame that is not whole
    size: int  # bytes from there to the end
    more: bool  # whole frames follow; False: only the end is missing, as after a kill of the recorder


@dataclass(frozen=True)
class Segment:
    """Content of a segment, up to its damage if any."""

    rows: list[NumberedRows]
    damage: Damage | None


class OpenSegment:
    """Segment file being written, which begins with its description.

    Args:
        path: The file; one of the same name is replaced.
        session: Name of the session.
        number: Number of the segment.
        bodies: Bodies of the first frames after the description.

    Raises:
        OSError: if it cannot be written; the file is then missing or complete.
    """

    def __init__(self, path: Path, session: str, number: int, bodies: Iterable[bytes] = ()) -> None:
        self.path, self.number = path, number
        self._salt = new_salt()
        self._end = len(self._salt)  # bytes
        head = self._salt + self._sealed([describe(session, number), *bodies])
        files.put(path, head)
        self._file = os.open(path, os.O_WRONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        self._end = self._synced = len(head)

    def append(self, bodies: Iterable[bytes]) -> None:
        """Append a frame for each body, all or none.

        Raises:
            OSError: nothing was appended.
        """
        data, offset = self._sealed(bodies), self._end
        left, end = memoryview(data), offset + len(data)
        steps.reach("append frames")
        try:
            while left:
                written = os.pwrite(self._file, left, offset)
                left, offset = left[written:], offset + written
        except OSError:
            with suppress(OSError):  # if this fails, the next frames overwrite the rest
                os.ftruncate(self._file, self._end)
            raise
        self._end = end

    def sync(self) -> None:
        """Make the appended frames durable; other threads may append meanwhile.

        Raises:
            OSError: frames appended since the last sync may be lost.
        """
        end = self._end
        if end > self._synced:
            steps.reach("sync frames")
            os.fsync(self._file)
            self._synced = end

    def close(self) -> None:
        """Close the file; may be called again, but not during `sync`."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1

    def _sealed(self, bodies: Iterable[bytes]) -> bytes:
        """Return the frames of bodies, valid only at the end of the file."""
        parts, end = list[bytes](), self._end
        for body in bodies:
            parts.append(seal(body, self._salt, end))
            end += len(parts[-1])
        return b"".join(parts)


def new_salt() -> bytes:
    """Return the random start of a new segment."""
    return _PREAMBLE + os.urandom(SALT_SIZE - len(_PREAMBLE))


def describe(session: str, number: int) -> bytes:
    """Return the body of the first frame of a segment."""
    kinds = [{"batch": kind.__name__, "columns": _layout(kind)} for kind in _KINDS]
    content = {"version": VERSION, "session": session, "segment": number, "kinds": kinds}
    return _HEAD.pack(_DESCRIPTION, 0, 0, 0) + json.dumps(content).encode()


def bodies(rows: Iterable[NumberedRows]) -> Iterator[bytes]:
    """Return the bodies of the frames for these rows; consecutive rows of a fingertip share one."""
    runs, newest = list[_Run](), dict[type[Batch], _Run]()
    for first, batch in rows:
        kind, count = type(batch), len(batch.time)
        most = (LIMIT - _HEAD.size) // _ROW_SIZES[kind]
        run = newest.get(kind)
        if run and run.end == first and run.finger == batch.finger and run.end - run.first + count <= most:
            run.batches.append(batch)
            run.end += count
            continue
        for start in range(0, count, most):
            part = batch if count <= most else batch[start : start + most]
            newest[kind] = _Run(first + start, first + start + len(part), batch.finger, [part])
            runs.append(newest[kind])
    return map(_body_of, runs)


@dataclass(slots=True)
class _Run:
    """Consecutive rows of one type and fingertip."""

    first: int  # number within its table
    end: int  # after the last
    finger: int
    batches: list[Batch]


def _body_of(run: _Run) -> bytes:
    kind = type(run.batches[0])
    names = columns(kind)
    parts = [_HEAD.pack(_CODES[kind], run.finger, run.end - run.first, run.first)]
    for column in zip(*map(attrgetter(*names), run.batches), strict=True):
        parts += [values.tobytes() for values in column]
    return b"".join(parts)


def seal(body: bytes, salt: bytes, offset: int) -> bytes:
    """Return the frame of a body, valid only at `offset` in the segment that begins with `salt`."""
    return _PREFIX.pack(_MAGIC, len(body), _checksum(body, salt, offset)) + body


def read_segment(data: bytes, where: str, session: str, number: int) -> Segment:
    """Return the rows of a segment, up to the first frame that is not whole.

    Args:
        data: Content of the file.
        where: Name for errors.
        session: Session that it must belong to.
        number: Number that it must have.

    Raises:
        InputError: if its description or a frame is invalid, or it has another version or session.
    """
    salt, offset = data[:SALT_SIZE], SALT_SIZE
    body = _body(data, salt, offset) if salt.startswith(_PREAMBLE) else None
    if body is None:
        return Segment([], Damage(0, len(data), more=len(data) > SALT_SIZE))
    kinds = _described(body, where, session, number)
    rows = list[NumberedRows]()
    while offset < len(data):
        body = _body(data, salt, offset)
        if body is None:
            return Segment(rows, Damage(offset, len(data) - offset, _more(data, salt, offset + 1)))
        if body[0] != _DESCRIPTION:
            rows.append(_rows(body, kinds, where))
        offset += _PREFIX.size + len(body)
    return Segment(rows, None)


def _checksum(body: bytes, salt: bytes, offset: int) -> int:
    return zlib.crc32(body, zlib.crc32(_POSITION.pack(offset, len(body)), zlib.crc32(salt)))


def _body(data: bytes, salt: bytes, offset: int) -> bytes | None:
    """Return the body of the frame at `offset`, None if there is no whole one."""
    if len(data) - offset < _PREFIX.size + _HEAD.size:
        return None
    magic, length, checksum = _PREFIX.unpack_from(data, offset)
    start = offset + _PREFIX.size
    if magic != _MAGIC or not _HEAD.size <= length <= min(LIMIT, len(data) - start):
        return None
    body = data[start : start + length]
    return body if _checksum(body, salt, offset) == checksum else None


def _more(data: bytes, salt: bytes, offset: int) -> bool:
    """Return true if a whole frame begins at `offset` or later."""
    hashed = 0
    while (offset := data.find(_MAGIC, offset)) >= 0 and hashed < _SEARCHED:
        if _body(data, salt, offset) is not None:
            return True
        hashed += min(int.from_bytes(data[offset + 4 : offset + 8], "little"), LIMIT)
        offset += 1
    return False


def _rows(body: bytes, kinds: Mapping[int, type[Batch]], where: str) -> NumberedRows:
    code, finger, count, first = _HEAD.unpack_from(body)
    kind = kinds.get(code)
    if kind is None or len(body) != _HEAD.size + count * _ROW_SIZES[kind]:
        raise InputError(where, f"has an invalid frame{_MOVE}")
    values, offset = list[NDArray[Any]](), _HEAD.size
    for column in columns(kind).values():
        size = math.prod(column.shape)
        values.append(
            np.frombuffer(body, column.dtype, count * size, offset).reshape(count, *column.shape).copy()
        )
        offset += count * size * column.dtype.itemsize
    return NumberedRows(first, kind(*values, finger=finger))


def _described(body: bytes, where: str, session: str, number: int) -> dict[int, type[Batch]]:
    """Return the batch types by their codes."""
    try:
        content: object = json.loads(body[_HEAD.size :])
    except (ValueError, RecursionError) as error:
        raise InputError(where, f"has invalid JSON{_MOVE}: {error}") from error
    if body[0] != _DESCRIPTION or not isinstance(content, dict):
        raise InputError(where, f"does not begin with a description{_MOVE}")
    about = cast("dict[str, Any]", content)
    if about.get("version") != VERSION:
        reason = f"has version {about.get('version')!r}, this slipflow reads version {VERSION}"
        raise InputError(where, f"{reason}: recover it with the software named in session.json")
    if (about.get("session"), about.get("segment")) != (session, number):
        reason = f"is segment {about.get('segment')!r} of session {about.get('session')!r}"
        raise InputError(where, f"{reason}; move it back there")
    known = {kind.__name__: kind for kind in _KINDS}
    kinds = dict[int, type[Batch]]()
    try:
        for code, each in enumerate(about["kinds"]):
            kind = known.get(each["batch"])
            if kind is None or _layout(kind) != each["columns"]:
                reason = f"has {each['batch']} rows with unknown columns: recover it"
                raise InputError(where, f"{reason} with the software named in session.json")
            kinds[code] = kind
    except (LookupError, TypeError) as error:
        raise InputError(where, f"has an invalid description{_MOVE}: {error!r}") from error
    return kinds


def _layout(kind: type[Batch]) -> list[list[Any]]:
    """Return the name, element type with byte order, shape and code names of each column."""
    found = columns(kind).items()
    return [[name, each.dtype.str, [*each.shape], [*each.names]] for name, each in found]

"""The frames of a journal: rows as bytes that cannot be taken for anything else.

.. code-block:: text

    segment   "SLIPWAL1", 8 random bytes; then frames, the first of which describes the segment as JSON
    frame     "SLIP", length of the body (4 bytes), CRC-32 (4 bytes); body
    body      code (1), finger (2), rows (4), number of the first in its table (8); the columns, end to end
    CRC-32    zlib's, of these, end to end: the 16 bytes with which the segment begins; where in the file the
              frame begins (8); length of the body (4); the body

All numbers are little-endian and, but for the finger, not signed. Since segment and place are in the CRC, a
frame that the disk gives back from elsewhere, such as from an older file whose blocks were used again, is
never valid, nor is a tail of zeros or a repeated one.
"""

import json
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from struct import Struct
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from operators.batch import Batch, columns
from operators.errors import InputError
from storage import files
from storage.layout import TABLE_OF

# of what bodies hold: raise it when that changes; other versions then refuse the segment and name it
VERSION: Final = 3  # 2 had frames of episodes
SINGLE_LOG: Final = -2  # of the one that has the rows of tables of one file
LIMIT: Final = 64 * files.MiB  # bytes of a body, looked at before any are read
WHOLE: Final = 8192 * files.MiB  # bytes of a segment, the same

# of how segments and frames are laid out: raise its digit when that changes; to other versions such a segment
# is damaged from its first byte, so a recovery by them puts it aside whole
_PREAMBLE: Final = b"SLIPWAL1"
_MAGIC: Final = b"SLIP"
_PREFIX: Final = Struct("<4sII")
_HEAD: Final = Struct("<BhIQ")
_PLACE: Final = Struct("<QI")
_KINDS: Final = tuple(TABLE_OF)  # a frame's code is a batch type's place here
_CODES: Final = {kind: code for code, kind in enumerate(_KINDS)}
_DESCRIPTION: Final = 255  # code; JSON follows
_SEARCHED: Final = 256 * files.MiB  # bytes, which a search for a frame may hash
_UNREAD: Final = "; move it away, and the rest can be recovered"
SALT_SIZE: Final = len(_PREAMBLE) + 8  # bytes, with which a segment begins


class Rows(NamedTuple):
    """Rows of one batch, and the number of the first within all that its table ever got."""

    first: int
    batch: Batch


@dataclass(frozen=True)
class Damage:
    """Where a segment cannot be read on."""

    offset: int  # bytes, of the first frame that is not whole
    size: int  # bytes from there to the end
    more: bool  # whole frames stand behind it: it is not just where the recorder was cut off


@dataclass(frozen=True)
class Segment:
    """What a segment holds, up to where it is damaged."""

    rows: list[Rows]
    damage: Damage | None


def new_salt() -> bytes:
    """How a new segment begins."""
    return _PREAMBLE + os.urandom(SALT_SIZE - len(_PREAMBLE))


def describe(session: str, number: int) -> bytes:
    """The body of a segment's first frame."""
    kinds = [{"batch": kind.__name__, "columns": _layout(kind)} for kind in _KINDS]
    return _note(_DESCRIPTION, {"version": VERSION, "session": session, "segment": number, "kinds": kinds})


def bodies(rows: Iterable[Rows]) -> Iterator[bytes]:
    """The bodies of the frames that hold these rows; those that follow on each other share one."""
    runs, newest = list[_Run](), dict[type[Batch], _Run]()
    for first, batch in rows:
        kind, count = type(batch), len(batch.time)
        most = (LIMIT - _HEAD.size) // _row_size(kind)
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
    """Rows of one type and fingertip that follow on each other."""

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
    """The frame of a body, valid at `offset` in the segment that begins with `salt` and nowhere else."""
    return _PREFIX.pack(_MAGIC, len(body), _checksum(body, salt, offset)) + body


def read_segment(data: bytes, where: str, session: str, number: int) -> Segment:
    """What the bytes of a segment hold, up to the first frame that is not whole.

    Args:
        data: All of them.
        where: What to call them in an error.
        session: That they must belong to.
        number: Of the segment.

    Raises:
        InputError: if they are whole but of a slipflow that keeps other rows, or of another session.
    """
    salt, offset = data[:SALT_SIZE], SALT_SIZE
    body = _body(data, salt, offset) if salt.startswith(_PREAMBLE) else None
    if body is None:
        return Segment([], Damage(0, len(data), more=len(data) > SALT_SIZE))
    kinds = _described(body, where, session, number)
    rows = list[Rows]()
    while offset < len(data):
        body = _body(data, salt, offset)
        if body is None:
            return Segment(rows, Damage(offset, len(data) - offset, _more(data, salt, offset + 1)))
        if body[0] != _DESCRIPTION:
            rows.append(_rows(body, kinds, where))
        offset += _PREFIX.size + len(body)
    return Segment(rows, None)


def _checksum(body: bytes, salt: bytes, offset: int) -> int:
    return zlib.crc32(body, zlib.crc32(_PLACE.pack(offset, len(body)), zlib.crc32(salt)))


def _body(data: bytes, salt: bytes, offset: int) -> bytes | None:
    """The body of the frame at `offset`; None if there is no whole one."""
    if len(data) - offset < _PREFIX.size + _HEAD.size:
        return None
    magic, length, checksum = _PREFIX.unpack_from(data, offset)
    start = offset + _PREFIX.size
    if magic != _MAGIC or not _HEAD.size <= length <= min(LIMIT, len(data) - start):
        return None
    body = data[start : start + length]
    return body if _checksum(body, salt, offset) == checksum else None


def _more(data: bytes, salt: bytes, offset: int) -> bool:
    """Whether a whole frame begins anywhere from `offset` on."""
    hashed = 0
    while (offset := data.find(_MAGIC, offset)) >= 0 and hashed < _SEARCHED:
        if _body(data, salt, offset) is not None:
            return True
        hashed += min(int.from_bytes(data[offset + 4 : offset + 8], "little"), LIMIT)
        offset += 1
    return False


def _rows(body: bytes, kinds: Mapping[int, type[Batch]], where: str) -> Rows:
    code, finger, count, first = _HEAD.unpack_from(body)
    kind = kinds.get(code)
    if kind is None or len(body) != _HEAD.size + count * _row_size(kind):
        raise InputError(where, f"holds a frame that no slipflow writes{_UNREAD}")
    values, offset = list[NDArray[Any]](), _HEAD.size
    for column in columns(kind).values():
        size = int(np.prod(column.shape, dtype=np.int64))
        values.append(
            np.frombuffer(body, column.dtype, count * size, offset).reshape(count, *column.shape).copy()
        )
        offset += count * size * column.dtype.itemsize
    return Rows(first, kind(*values, finger=finger))


def _described(body: bytes, where: str, session: str, number: int) -> dict[int, type[Batch]]:
    """The batch types by their codes."""
    about = _json(body, where)
    if body[0] != _DESCRIPTION or not isinstance(about, dict):
        raise InputError(where, f"does not begin with a description{_UNREAD}")
    said = cast("dict[str, Any]", about)
    if said.get("version") != VERSION:
        reason = f"is of version {said.get('version')!r}, this slipflow knows {VERSION}: recover it with"
        raise InputError(where, f"{reason} the slipflow that session.json names")
    if (said.get("session"), said.get("segment")) != (session, number):
        reason = f"is segment {said.get('segment')!r} of session {said.get('session')!r}; put it back there"
        raise InputError(where, reason)
    known = {kind.__name__: kind for kind in _KINDS}
    kinds = dict[int, type[Batch]]()
    try:
        for code, each in enumerate(said["kinds"]):
            kind = known.get(each["batch"])
            if kind is None or _layout(kind) != each["columns"]:
                reason = f"has {each['batch']} rows of other columns than this slipflow keeps: recover it"
                raise InputError(where, f"{reason} with the slipflow that session.json names")
            kinds[code] = kind
    except (LookupError, TypeError) as error:
        raise InputError(where, f"is described as no slipflow does{_UNREAD}: {error!r}") from error
    return kinds


def _layout(kind: type[Batch]) -> list[list[Any]]:
    """Return name, element type with its byte order, shape and names of the codes of each column."""
    found = columns(kind).items()
    return [[name, each.dtype.str, [*each.shape], [*each.names]] for name, each in found]


def _row_size(kind: type[Batch]) -> int:
    size = _sizes.get(kind)
    if size is None:
        each = columns(kind).values()
        size = sum(column.dtype.itemsize * int(np.prod(column.shape, dtype=np.int64)) for column in each)
        _sizes[kind] = size
    return size


_sizes: Final[dict[type[Batch], int]] = {}  # bytes of a row


def _note(code: int, content: object) -> bytes:
    return _HEAD.pack(code, 0, 0, 0) + json.dumps(content).encode()


def _json(body: bytes, where: str) -> object:
    try:
        found: object = json.loads(body[_HEAD.size :])
    except (ValueError, RecursionError) as error:
        raise InputError(where, f"holds text that is no JSON{_UNREAD}: {error}") from error
    return found

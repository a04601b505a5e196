"""Append-only log: a file of records, each of which is stored completely or not at all.

.. code-block:: text

    log       header, then a frame per record
    header    "SLIPLOG" and version (8 bytes), nonce (16), length of the identity (4), identity, CRC-32 (4)
    frame     "SLIP", length of the record (4), record, CRC-32 (4)

The CRC-32 is zlib's. The CRC of the header covers the rest of the header. The CRC of a frame starts from the
CRC of the header, which covers the random nonce, and covers the frame's offset in the file (8 bytes), the CRC
before the frame (4), and the rest of the frame. Bytes of an older log, of a failed append or of a repeated
block are therefore never read as records. All numbers are little-endian and unsigned.

The caller decides when to `sync`, which may run in a different thread from `append`. A log has no threads.
"""

import os
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from errno import EIO
from pathlib import Path
from struct import Struct
from threading import Lock
from typing import Final, NamedTuple

from operators.errors import InputError
from storage import files

VERSION: Final = 1
LIMIT: Final = 64 * files.MiB  # bytes of a record and of an identity
SIZE_MAX: Final = 2047 * files.MiB  # bytes of a log, which is read at once

_MAGIC: Final = b"SLIPLOG"
_HEAD: Final = Struct("<8s16sI")
_FRAME_MAGIC: Final = b"SLIP"
_PREFIX: Final = Struct("<4sI")
_POSITION: Final = Struct("<QI")  # in this order the header does not cancel out in the first frame
_CRC: Final = 4  # bytes
_OVERHEAD: Final = _PREFIX.size + _CRC  # bytes of a frame without its record


class Record(NamedTuple):
    """Record of a log, and the offset of its frame in the file."""

    offset: int
    data: bytes


@dataclass(frozen=True)
class Damage:
    """Part of a log that cannot be read."""

    offset: int  # bytes, of the first frame that is not whole
    size: int  # bytes from there to the end
    torn: bool  # its frame reaches beyond the end, or only zeros follow: so a crash of the writer leaves it


class LogReader:
    """Reader of a log as it was when the reader was made; it may be written further.

    Attributes:
        path: The file.
        identity: Identity that the writer gave the log; empty if the header is damaged.
        damage: Unreadable part; known once `records` has ended, or at once if it is the header.
        end: Offset after the last record that was read.

    Raises:
        InputError: if the log has another version, or is larger than `SIZE_MAX`.
        OSError: if the file cannot be read; this is never reported as damage.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.identity = path, b""
        self.damage: Damage | None = None
        self._start = self.end = -1  # of the first frame; below 0: the header is damaged
        descriptor = files.open_file(path)
        try:
            if (size := os.fstat(descriptor).st_size) > SIZE_MAX:
                reason = f"is larger than {SIZE_MAX // files.MiB:,} MiB, the limit for a log"
                raise InputError(str(path), reason)
            self._data = os.pread(descriptor, size, 0)
        finally:
            os.close(descriptor)
        self._seed = self._crc = self._read_header()

    def records(self, offset: int | None = None) -> Iterator[Record]:
        """Yield the records from an offset (default: the first record) up to the end or the first damage."""
        if self._start < 0:
            return
        self.damage, self.end = None, self._start if offset is None else offset
        self._crc = int.from_bytes(self._data[self.end - _CRC : self.end], "little")
        while self.end < len(self._data):
            record = self._next()
            if record is None:
                self.damage = Damage(self.end, len(self._data) - self.end, self._is_torn())
                return
            yield record

    def _read_header(self) -> int:
        """Read the header and return its CRC."""
        if len(self._data) >= _HEAD.size:
            magic, _, length = _HEAD.unpack_from(self._data)
            if magic[:-1] == _MAGIC and magic != _MAGIC + bytes([VERSION]):
                reason = f"has log version {magic[-1]}; this slipflow reads version {VERSION}"
                raise InputError(str(self.path), f"{reason}: read it with the slipflow that wrote it")
            end = _HEAD.size + length
            crc = zlib.crc32(self._data[:end])
            if magic[:-1] == _MAGIC and self._data[end : end + _CRC] == crc.to_bytes(_CRC, "little"):
                self.identity, self._start, self.end = self._data[_HEAD.size : end], end + _CRC, end + _CRC
                return crc
        self.damage = Damage(0, len(self._data), torn=len(self._data) <= _HEAD.size)
        return 0

    def _next(self) -> Record | None:
        """Return the next record; None if its frame is not whole."""
        prefix, start = self._data[self.end : self.end + _PREFIX.size], self.end + _PREFIX.size
        if len(prefix) < _PREFIX.size:
            return None
        magic, length = _PREFIX.unpack(prefix)
        data = self._data[start : start + length]
        crc = _checksum(prefix, data, _POSITION.pack(self.end, self._crc), self._seed)
        check = self._data[start + length : start + length + _CRC]
        if magic != _FRAME_MAGIC or check != crc.to_bytes(_CRC, "little"):
            return None
        record = Record(self.end, data)
        self.end, self._crc = start + length + _CRC, crc
        return record

    def _is_torn(self) -> bool:
        """Return true if the frame at `end` reaches beyond the end of the file, or only zeros follow."""
        tail = self._data[self.end :]
        if len(tail) < _OVERHEAD:
            return True
        magic, length = _PREFIX.unpack_from(tail)
        return (magic == _FRAME_MAGIC and len(tail) - _OVERHEAD < length <= LIMIT) or not tail.lstrip(b"\0")


class AppendLog:
    """New log, created durably with its first records, for appending; it replaces an existing file.

    Attributes:
        path: The file.
        end: Offset of the next frame, which is the size of the file.
        suspect: True if an fsync failed: the kernel may have dropped records that were not durable yet, and a
            second fsync would prove nothing. Also if an append failed and could not be undone. Write the
            records that are not durable to a new log.

    Raises:
        OSError: if it cannot be written; the old or the new file remains.
    """

    def __init__(self, path: Path, identity: bytes, records: Iterable[bytes] = ()) -> None:
        head = _HEAD.pack(_MAGIC + bytes([VERSION]), os.urandom(16), len(identity)) + identity
        self.path, self.suspect, self._seed = path, False, zlib.crc32(head)
        head += self._seed.to_bytes(_CRC, "little")
        data, _, self._crc = _frames(records, len(head), self._seed, self._seed)
        files.put(path, head + data)
        self.end = self._synced = len(head) + len(data)
        self._closing = Lock()  # held during an fsync
        self._file = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)

    def append(self, records: Iterable[bytes]) -> list[int]:
        """Append records, all or none, and return their offsets.

        Raises:
            OSError: nothing was appended; the log is `suspect` if bytes of the failed append may be left.
        """
        data, offsets, crc = _frames(records, self.end, self._crc, self._seed)
        try:
            files.write_at(self._file, data, self.end)
        except BaseException as error:
            try:
                os.ftruncate(self._file, self.end)
            except OSError:
                self.suspect = True
            if isinstance(error, OSError):
                error.filename = str(self.path)
            raise
        self.end, self._crc = self.end + len(data), crc
        return offsets

    @property
    def unsynced(self) -> bool:
        """True if records were appended since the last sync."""
        return self.end > self._synced

    def sync(self) -> None:
        """Make the appended records durable; other threads may append or close the log meanwhile.

        Raises:
            OSError: records since the last sync may be lost; the log is `suspect` from then on.
        """
        with self._closing:
            if self.suspect:
                raise OSError(EIO, "an earlier write failed", str(self.path))
            end = self.end
            if end > self._synced and self._file >= 0:
                try:
                    os.fsync(self._file)
                except OSError as error:
                    self.suspect, error.filename = True, str(self.path)
                    raise
                self._synced = end

    def close(self) -> None:
        """Close the file without a sync; may be called again."""
        with self._closing:
            if self._file >= 0:
                os.close(self._file)
            self._file = -1


def _frames(records: Iterable[bytes], offset: int, crc: int, seed: int) -> tuple[bytes, list[int], int]:
    """Return the frames of records as one, their offsets, and the CRC of the last."""
    parts, offsets = list[bytes](), list[int]()
    for record in records:
        if len(record) > LIMIT:
            raise ValueError(f"a record has {len(record)} bytes, at most {LIMIT} are allowed")
        prefix = _PREFIX.pack(_FRAME_MAGIC, len(record))
        crc = _checksum(prefix, record, _POSITION.pack(offset, crc), seed)
        parts += [prefix, record, crc.to_bytes(_CRC, "little")]
        offsets.append(offset)
        offset += _OVERHEAD + len(record)
    return b"".join(parts), offsets, crc


def _checksum(prefix: bytes, record: bytes, position: bytes, seed: int) -> int:
    """Return the CRC of a frame at a position in a log whose header has the CRC `seed`."""
    return zlib.crc32(record, zlib.crc32(prefix, zlib.crc32(position, seed)))

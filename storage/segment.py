"""A segment of the journal while it is written: frames are appended whole or not at all."""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from storage import files, frames, steps


class OpenSegment:
    """One file of the journal, there with its first frame from the start."""

    def __init__(self, path: Path, session: str, number: int, bodies: Iterable[bytes] = ()) -> None:
        """Make it, in place of one of the same name, with a frame for each body from the start.

        Raises:
            OSError: it is not there, or is whole.
        """
        self.path, self.number = path, number
        self._salt = frames.new_salt()
        self._end = len(self._salt)  # bytes
        head = self._salt + self._sealed([frames.describe(session, number), *bodies])
        files.put(path, head)
        self._file = os.open(path, os.O_WRONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        self._end = self._synced = len(head)

    def append(self, bodies: Iterable[bytes]) -> None:
        """Add a frame for each body, all or none.

        Raises:
            OSError: the segment ends where it did before.
        """
        data, place = self._sealed(bodies), self._end
        left, end = memoryview(data), place + len(data)
        steps.reach("append frames")
        try:
            while left:
                written = os.pwrite(self._file, left, place)
                left, place = left[written:], place + written
        except OSError:
            with suppress(OSError):  # else the next frames are written over what is there
                os.ftruncate(self._file, self._end)
            raise
        self._end = end

    def sync(self) -> None:
        """Make durable what was appended; others may append meanwhile.

        Raises:
            OSError: what was appended since the last time may never become so.
        """
        end = self._end
        if end > self._synced:
            steps.reach("sync frames")
            os.fsync(self._file)
            self._synced = end

    def _sealed(self, bodies: Iterable[bytes]) -> bytes:
        """The frames of bodies, for the end of the file."""
        parts, end = list[bytes](), self._end
        for body in bodies:
            parts.append(frames.seal(body, self._salt, end))
            end += len(parts[-1])
        return b"".join(parts)

    def close(self) -> None:
        """Let go of the file; nothing may be syncing; may be called again."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1

"""Files that are in place at once, but durable only together and later: those of a replay."""

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from errno import EIO
from hashlib import sha256
from pathlib import Path
from typing import Final

from storage import files, steps

AT_ONCE: Final = 8  # files that the disk is asked for at a time: it makes many durable in one go


class Unsettled:
    """What was put somewhere since it was last made durable.

    Whoever looks finds each file whole. A power cut before `settle` may leave any of them old or new, there
    or not, or with anything in it.
    """

    def __init__(self) -> None:
        """Begin with none."""
        self._files: dict[Path, bytes] = {}  # sha256 of each
        self._folders: set[Path] = set()
        self._doubtful = False  # an fsync failed

    def put(self, path: Path, data: bytes) -> None:
        """Write a file as `files.put` does, but for its being durable.

        Raises:
            OSError: the old one is still there.
        """
        files.place(path, data, durable=False)
        self._files[path] = sha256(data).digest()
        self._folders.add(path.parent)

    def make_folder(self, path: Path, *, new: bool = False) -> None:
        """Make a folder as `files.make_folder` does, but for its being durable.

        Raises:
            FileExistsError: if there is one and it has to be `new`.
            OSError: if it cannot be made.
        """
        path.mkdir(exist_ok=not new)
        self._folders |= {path, path.parent}

    def settle(self) -> None:
        """Make all of it durable: the files, then their names.

        Raises:
            OSError: some of it may not be; it may be tried again, while what was written can still be read.
        """
        if self._doubtful:  # the fsync alone, tried again, could seem to work
            self._write_anew()
        self._doubtful = True
        _sync(self._files, "sync")
        _sync(self._folders, "settle")
        self._doubtful = False
        self._files.clear()
        self._folders.clear()

    def _write_anew(self) -> None:
        for path, digest in self._files.items():
            data = path.read_bytes()
            if sha256(data).digest() != digest:
                raise OSError(EIO, "what was written is not there any more; replay it again")
            files.place(path, data, durable=False)


def _sync(paths: Iterable[Path], action: str) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        syncing = list[Future[None]]()
        for path in sorted(paths):
            steps.reach(f"{action} {files.kind(path)}")
            syncing.append(pool.submit(files.sync, path))
        for each in syncing:
            each.result()

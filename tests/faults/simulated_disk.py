"""Disk faults below real files: kills between any two operations, torn writes, errors, lost caches."""

import errno
import fcntl
import os
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from stat import S_ISDIR
from typing import Any
from unittest.mock import patch

from tests.faults.simulated_process import Killed, SimulatedProcess, current

TAILS = ("cut", "zeros", "garbage")  # content after the last byte that reached the disk


@dataclass
class _Inode:
    """Content of a file that survives a power loss, and ranges that a failed fsync dropped for good."""

    durable: bytes = b""
    dropped: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # from, to
    failed: bool = False  # an fsync failed and its pages may be dropped


class SimulatedDisk:
    """Folder whose files are real and whose operations fail as a schedule says.

    A file is durable as of its last fsync, a name as of the last fsync of its folder. A power loss keeps each
    later change or not, in any mixture, which is more than file systems are known to do. After an fsync that
    failed, its pages count as clean: a second fsync succeeds and does not write them (fsync(2), "fsyncgate").
    """

    def __init__(self, root: Path, random: Random) -> None:
        self._root, self._random = str(root), random
        self.error = 0  # errno of each write, fsync and new file; 0: none
        self.fsync_error = False  # fsync fails with EIO
        self.kill_in = 0  # operations of a process until it is killed in the middle of one; 0: never
        self.operations = 0
        self._inodes: dict[int, _Inode] = {}
        self._names: dict[str, dict[str, int]] = {}  # durable inode of each name, by folder
        self._open_files = dict[int, str]()  # paths by descriptor
        self._locks = dict[int, SimulatedProcess]()
        self._real: dict[str, Callable[..., Any]] = {}

    @contextmanager
    def attached(self) -> Generator[None]:
        """Pass the operations of the module `os` through the simulation."""
        with ExitStack() as stack:
            for name in ("open", "close", "pwrite", "fsync", "ftruncate"):
                self._real[name] = getattr(os, name)
                stack.enter_context(patch.object(os, name, getattr(self, f"_{name}")))
            for name in ("mkdir", "rmdir", "unlink", "rename", "replace"):
                self._real[name] = getattr(os, name)
                stack.enter_context(patch.object(os, name, self._named(name)))
            yield

    def lose_power(self) -> None:
        """Replace the files by a state that a power loss may leave."""
        image = self._image(self._root)
        self._inodes.clear()
        self._names.clear()
        for folder, _, names in os.walk(self._root, topdown=False):
            for name in names:
                if f"{folder}/{name}" not in image:
                    self._real["unlink"](f"{folder}/{name}")
            if folder not in image and folder != self._root:
                self._real["rmdir"](folder)
        for path, content in image.items():
            self._restore(path, content)
        for folder, _, _ in os.walk(self._root):
            self._names[folder] = _listed(folder)

    def _restore(self, path: str, content: bytes | None) -> None:
        """Create a folder (None), or a file with a content that is durable."""
        if content is None:
            if not os.path.isdir(path):
                self._real["mkdir"](path)
            return
        descriptor = self._real["open"](path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        if content:
            os.write(descriptor, content)
        self._inodes[os.fstat(descriptor).st_ino] = _Inode(content)
        self._real["close"](descriptor)

    def noting_locks(self, flock: Callable[..., int | None]) -> Callable[..., int | None]:
        """Return a lock function whose locks end when the process that holds them is killed."""

        def locked(descriptor: int, *kind: int) -> int | None:
            process = current()  # raises if the process was killed: it locks nothing
            found = flock(descriptor, *kind)
            if process and found is not None:
                self._locks[found] = process
                process.on_kill.append(lambda: self._unlock(found, process))
            return found

        return locked

    def _unlock(self, descriptor: int, process: SimulatedProcess) -> None:
        if self._locks.get(descriptor) is process:
            fcntl.flock(descriptor, fcntl.LOCK_UN)

    def close_files(self) -> None:
        for descriptor in list(self._open_files):
            self._close(descriptor)

    def _image(self, folder: str) -> dict[str, bytes | None]:
        """Return the surviving content by path; None for a folder."""
        image: dict[str, bytes | None] = {}
        durable, present = self._names.get(folder, {}), _listed(folder)
        for name in sorted(durable.keys() | present.keys()):
            same = durable.get(name) == present.get(name)
            inode = (present if same or self._random.random() < 0.5 else durable).get(name)
            if inode is None:
                continue
            path = f"{folder}/{name}"
            if os.path.isdir(path):
                image[path] = None
                image |= self._image(path)
                continue
            known = self._inodes.get(inode, _Inode())
            whole = Path(path).read_bytes() if present.get(name) == inode else known.durable
            image[path] = self._survivor(known, whole)
        return image

    def _survivor(self, known: _Inode, whole: bytes) -> bytes:
        """Return the content of a file after a power loss: its durable bytes and some of the later ones."""
        durable = known.durable
        if not whole.startswith(durable):  # truncated since its last fsync
            return durable if self._random.random() < 0.5 else whole
        rest = whole[len(durable) :]
        if not rest:
            return durable
        at = self._random.choice((0, len(rest), self._random.randrange(len(rest) + 1)))
        tail = self._random.choice(TAILS)
        lost = len(rest) - at
        return (
            durable
            + rest[:at]
            + {"cut": b"", "zeros": bytes(lost), "garbage": self._random.randbytes(lost)}[tail]
        )

    def _simulated(self, path: str | None) -> bool:
        return path is not None and path.startswith(self._root) and current() is not None

    def _fails(self) -> bool:
        """Return True if the running process has the disk that fails; the consumer has another one."""
        process = current()
        return process is not None and process.name == "rig"

    def _step(self, path: str | None, *, grows: bool = False) -> None:
        """Count an operation; kill the process or fail as scheduled.

        Raises:
            Killed: if the process dies before the operation.
            OSError: as scheduled.
        """
        if not self._simulated(path):
            return
        self.operations += 1
        process = current()
        if self.kill_in and process and self._fails():
            self.kill_in -= 1
            if not self.kill_in:
                process.kill()
                raise Killed(process.name)
        if grows and self.error and self._fails():
            raise OSError(self.error, os.strerror(self.error), path)

    def _open(self, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        name = _text(path)
        new = bool(flags & os.O_CREAT) and name is not None and not os.path.lexists(name)
        if new:
            self._step(name, grows=True)
        descriptor: int = self._real["open"](path, flags, mode, dir_fd=dir_fd)
        if name is not None and name.startswith(self._root):
            self._open_files[descriptor] = name
        if new and self._simulated(name):
            self._inodes[os.fstat(descriptor).st_ino] = _Inode()
        return descriptor

    def _close(self, descriptor: int) -> None:
        self._open_files.pop(descriptor, None)
        self._locks.pop(descriptor, None)
        self._real["close"](descriptor)

    def _pwrite(self, descriptor: int, data: Any, offset: int) -> int:
        """Write all, or on a kill or a full disk any first part."""
        path, write = self._open_files.get(descriptor), self._real["pwrite"]
        if not self._simulated(path):
            return int(write(descriptor, data, offset))
        view = memoryview(data).cast("B")
        part = self._random.randrange(len(view)) if view else 0
        try:
            self._step(path, grows=True)
        except Killed:
            write(descriptor, view[:part], offset)
            raise
        except OSError as error:
            if error.errno == errno.ENOSPC and part:
                return int(
                    write(descriptor, view[:part], offset)
                )  # write(2): as many bytes as there is room for
            raise
        return int(write(descriptor, data, offset))

    def _fsync(self, descriptor: int) -> None:
        path = self._open_files.get(descriptor)
        if path is None:
            self._real["fsync"](descriptor)
            return
        self._step(path)
        status = os.fstat(descriptor)
        folder = S_ISDIR(status.st_mode)
        if self._fails() and (self.fsync_error or self.error == errno.EIO):
            if not folder:
                known = self._inodes.setdefault(status.st_ino, _Inode())
                known.dropped.append((len(known.durable), status.st_size))
            raise OSError(errno.EIO, os.strerror(errno.EIO), path)
        if folder:
            self._names[path] = _listed(path)
            return
        known = self._inodes.setdefault(status.st_ino, _Inode())
        known.durable = os.pread(descriptor, status.st_size, 0)
        for start, end in known.dropped:
            content = bytearray(known.durable)
            content[start:end] = bytes(max(0, min(end, len(content)) - start))
            known.durable = bytes(content)

    def _ftruncate(self, descriptor: int, size: int) -> None:
        path = self._open_files.get(descriptor)
        self._step(path)
        if self._simulated(path) and self._fails() and self.error == errno.EIO:
            raise OSError(errno.EIO, os.strerror(errno.EIO), path)
        self._real["ftruncate"](descriptor, size)

    def _named(self, name: str) -> Callable[..., Any]:
        def operate(path: Any, *args: Any, **options: Any) -> Any:
            self._step(_text(path), grows=name == "mkdir")
            done = self._real[name](path, *args, **options)
            if name == "rename" and (folder := _text(path)):
                moved = [each for each in self._names if f"{each}/".startswith(f"{folder}/")]
                for each in moved:  # what is durable in a folder stays so under its new name
                    self._names[f"{_text(args[0])}{each.removeprefix(folder)}"] = self._names.pop(each)
            return done

        return operate


def _text(path: int | str | bytes | os.PathLike[str]) -> str | None:
    """Return a path as text; None for a descriptor or bytes."""
    found = path if isinstance(path, int) else os.fspath(path)
    return found if isinstance(found, str) else None


def _listed(folder: str) -> dict[str, int]:
    try:
        with os.scandir(folder) as entries:
            return {entry.name: entry.inode() for entry in entries}
    except FileNotFoundError:
        return {}

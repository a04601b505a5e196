"""Exclusive locks of folders and files, released when the process ends."""

import fcntl
import os
from pathlib import Path


def lock(folder: Path, *, wait: bool = False) -> int | None:
    """Lock a folder; return the descriptor that holds the lock until it is closed.

    Return None if another process holds the lock, unless `wait` is set.

    Raises:
        OSError: if the folder cannot be locked.
    """
    return _flock(os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC), wait=wait)


def lock_file(path: Path) -> int | None:
    """Lock a file through ``<path>.lock``, which is never deleted; the file may be missing or be replaced.

    Return a descriptor or None as `lock` does.

    Raises:
        OSError: if the lock file cannot be created.
    """
    return _flock(os.open(f"{path}.lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600), wait=False)


def locked(folder: Path) -> bool:
    """Return True if a process holds the lock of a folder; False also if the folder cannot be opened."""
    try:
        descriptor = lock(folder)
    except OSError:
        return False
    if descriptor is not None:
        os.close(descriptor)
    return descriptor is None


def _flock(descriptor: int, *, wait: bool) -> int | None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        os.close(descriptor)
        return None
    except OSError:
        os.close(descriptor)
        raise
    return descriptor

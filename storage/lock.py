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
    """Lock a file, which may be missing or replaced later, through ``<path>.lock``, which remains.

    Return a descriptor or None as `lock` does.

    Raises:
        OSError: if the lock file cannot be created.
    """
    return _flock(os.open(f"{path}.lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600), wait=False)


def locked(folder: Path) -> bool:
    """Return True if a process holds the lock of a folder, as far as it can be determined."""
    try:
        number = lock(folder)
    except OSError:
        return False
    if number is not None:
        os.close(number)
    return number is None


def _flock(number: int, *, wait: bool) -> int | None:
    try:
        fcntl.flock(number, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        os.close(number)
        return None
    except OSError:
        os.close(number)
        raise
    return number

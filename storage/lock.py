"""Who may write to a session: one at a time, told by a lock on its folder that ends with the process."""

import fcntl
import os
from pathlib import Path


def lock(folder: Path, *, wait: bool = False) -> int | None:
    """Lock a folder; give the descriptor that holds the lock until it is closed.

    None if another has it, unless told to wait.

    Raises:
        OSError: if it cannot be locked.
    """
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        os.close(number)
        return None
    except OSError:
        os.close(number)
        raise
    return number


def locked(folder: Path) -> bool:
    """Whether somebody writes to a session just now, as far as can be known."""
    try:
        number = lock(folder)
    except OSError:
        return False
    if number is not None:
        os.close(number)
    return number is None

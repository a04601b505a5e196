"""Keeping others away from a file."""

import os
from pathlib import Path


def lock_beside(path: Path) -> int:
    """Lock ``<path>.lock``, which stays when the lock goes: with the process, or the descriptor given.

    A file beside, for the file itself may be replaced.

    Raises:
        BlockingIOError: if somebody else holds it.
        OSError: if it cannot be made.
    """
    from fcntl import LOCK_EX, LOCK_NB, flock  # noqa: PLC0415 - not on every system

    held = os.open(f"{path}.lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
    try:
        flock(held, LOCK_EX | LOCK_NB)
    except BaseException:
        os.close(held)
        raise
    return held

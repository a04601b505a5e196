"""What the head of a table says of where it was printed."""

import os
import platform
import subprocess
from collections.abc import Generator
from contextlib import contextmanager


def commit() -> str:
    """The commit of the working tree, "-dirty" behind it if it was changed since."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    )
    return told.stdout.strip()


def machine() -> str:
    """The processor, the cores, the version of Python."""
    processor = platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}"


@contextmanager
def real_time_priority() -> Generator[str]:
    """Give child processes real-time priority if allowed, so that other processes do not affect them."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        yield "normal"
        return
    try:
        yield "real-time"
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

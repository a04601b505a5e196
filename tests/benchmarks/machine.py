"""What the head of a table says of where it was printed."""

import os
import platform
import subprocess


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

"""The head of a table: what was measured, and where."""

import os
import platform
import subprocess

import numpy as np


def commit() -> str:
    """Return the commit of the working tree, "-dirty" behind it if it was changed since."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    )
    return told.stdout.strip()


def print_head(about: str) -> None:
    """Print what is measured, the commit, the machine and its load."""
    print(f"{about}, seed 0, commit {commit()}")
    processor = platform.processor() or platform.machine()
    print(f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}")
    print(f"load {os.getloadavg()[0]:.1f} at the beginning", flush=True)

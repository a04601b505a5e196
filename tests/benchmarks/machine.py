"""What all benchmarks share: the head of a table, turns, and the live cost of a flow."""

import gc
import os
import platform
import subprocess
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

Key = TypeVar("Key")


def commit() -> str:
    """Return the commit of the working tree, "-dirty" behind it if it was changed since."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    )
    return described.stdout.strip()


def print_head(about: str) -> None:
    """Print what is measured, the commit, the machine and its load."""
    print(f"{about}, seed 0, commit {commit()}")
    processor = platform.processor() or platform.machine()
    print(f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}")
    print(f"load {os.getloadavg()[0]:.1f} at the beginning", flush=True)


def take_turns(measures: Mapping[Key, Callable[[], float]], turns: int) -> dict[Key, list[float]]:
    """Call all functions in turns, so that a change of the machine's speed affects all of them.

    Returns:
        Costs by function, without those of the first turn, which warms up.
    """
    found: dict[Key, list[float]] = {key: [] for key in measures}
    for turn in range(turns + 1):
        for key, measure in measures.items():
            gc.collect()
            gc.disable()
            cost = measure()
            gc.enable()
            if turn:
                found[key].append(cost)
    return found

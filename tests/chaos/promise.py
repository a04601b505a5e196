"""What is promised, and whether it was kept: the rows of one table."""

import os
import platform
from collections.abc import Iterable
from dataclasses import dataclass

from tests.benchmarks.machine import commit


@dataclass(frozen=True)
class Promise:
    """One promise, put to the test."""

    claim: str  # what was done, and what must hold
    result: str  # what was seen
    bound: str  # what it had to be
    kept: bool
    others: str = ""  # what the tools that people trust do, measured once


def table(promises: Iterable[Promise]) -> str:
    """All of them, for a person to read.

    >>> print(table([Promise("SIGKILL x3", "0 lost", "0 lost", kept=True, others="MCAP 418")]))
    claim       result  bound   others    kept
    SIGKILL x3  0 lost  0 lost  MCAP 418  yes
    """
    rows = [("claim", "result", "bound", "others", "kept")]
    rows += [
        (each.claim, each.result, each.bound, each.others, "yes" if each.kept else "NO") for each in promises
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def machine(seed: int) -> str:
    """Where it was measured."""
    cores = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return f"seed {seed}, commit {commit()}\n{cores}"

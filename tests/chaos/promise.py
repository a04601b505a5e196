"""Results of the tests of promises, as a table."""

import os
import platform
from collections.abc import Iterable
from dataclasses import dataclass

from tests.benchmarks.machine import commit


@dataclass(frozen=True)
class Promise:
    """Test of one promise."""

    claim: str  # what was done
    result: str  # what happened
    bound: str  # what is promised
    passed: bool
    others: str = ""  # results of other tools, measured once


def table(promises: Iterable[Promise]) -> str:
    """Return a table as text.

    >>> print(table([Promise("SIGKILL x3", "0 lost", "0 lost", passed=True, others="MCAP 418")]))
    test        result  bound   others    passed
    SIGKILL x3  0 lost  0 lost  MCAP 418  yes
    """
    rows = [("test", "result", "bound", "others", "passed")]
    rows += [
        (each.claim, each.result, each.bound, each.others, "yes" if each.passed else "NO")
        for each in promises
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def machine(seed: int) -> str:
    """Return commit, seed and machine."""
    cores = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return f"seed {seed}, commit {commit()}\n{cores}"

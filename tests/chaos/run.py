"""Test the promises that need real processes and brokers, and print a table; exit 1 if one fails.

python -m tests.chaos.run [--only NAME] [--seed N] [--short]
"""

import argparse
import os
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import TypeAlias

from flows.report.table import Table
from tests.benchmarks.machine import commit


@dataclass(frozen=True)
class Scale:
    """Full test, or the short one of the test suite."""

    seed: int = 0  # of all random draws
    short: bool = False


@dataclass(frozen=True)
class Promise:
    """Test of one promise."""

    claim: str  # what was done
    result: str  # what happened
    bound: str  # what is promised
    passed: bool


Test: TypeAlias = Callable[[Scale], Sequence[Promise]]


def main() -> int:
    """Run all tests, or the subjects given."""
    from tests.chaos import events, recorder

    subjects: dict[str, Test] = {"recorder": recorder.kills, "events": events.kills}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--only", choices=list(subjects), action="append", help="test this subject only; may be repeated"
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed (default 0)")
    parser.add_argument("--short", action="store_true", help="run the short tests of the test suite")
    options = parser.parse_args()
    scale, promises = Scale(options.seed, options.short), list[Promise]()
    for subject in options.only or subjects:
        began = monotonic()
        for promise in subjects[subject](scale):
            word = "passed" if promise.passed else "FAILED"
            line = f"{word} ({monotonic() - began:.0f} s)  {promise.claim}: {promise.result}\n"
            sys.stderr.write(line)
            promises.append(promise)
    rows = [(each.claim, each.result, each.bound, "yes" if each.passed else "NO") for each in promises]
    table = Table(["test", "result", "bound", "passed"], rows)
    cores = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    sys.stdout.write(f"seed {scale.seed}, commit {commit()}\n{cores}\n\n{table.markdown()}\n")
    return 0 if all(each.passed for each in promises) else 1


if __name__ == "__main__":
    sys.exit(main())

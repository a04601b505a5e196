"""Test all promises and print a table; the exit code is 1 if a test fails.

python -m tests.chaos.run [--only NAME] [--seed N] [--short]
"""

import argparse
import importlib
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from time import monotonic
from typing import TypeAlias

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from tests.chaos.child import ROOT
from tests.chaos.promise import Promise, machine, table
from tests.chaos.scale import Scale

Test: TypeAlias = Callable[[Scale], "Promise | Sequence[Promise]"]


def subjects() -> dict[str, Sequence[Test]]:
    """Return the tests by the name of their file, which lists them in `PROMISES`."""
    found = dict[str, Sequence[Test]]()
    for path in sorted((ROOT / "tests/chaos").glob("*.py")):
        if "PROMISES" in path.read_text() and path.stem != "run" and not path.stem.startswith("test_"):
            found[path.stem] = importlib.import_module(f"tests.chaos.{path.stem}").PROMISES
    return found


def run_test(test: Test, scale: Scale) -> Sequence[Promise]:
    """Run a test and return its results; an exception counts as a failed test."""
    try:
        promises = test(scale)
    except Exception as error:  # noqa: BLE001 - the other tests must run too
        traceback.print_exc()
        where = f"{test.__module__.rpartition('.')[2]}: {test.__name__}"
        return [Promise(where, f"{type(error).__name__}: {error}"[:200], "a result", passed=False)]
    return [promises] if isinstance(promises, Promise) else promises


def run_all(tests: Iterable[tuple[str, Test]], scale: Scale) -> list[Promise]:
    """Run tests, show the progress, and return the results."""
    console, promises = Console(stderr=True), list[Promise]()
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        for subject, test in tests:
            summary = (test.__doc__ or "").partition("\n")[0]
            task, began = progress.add_task(f"{subject}: {summary}", total=None), monotonic()
            found = run_test(test, scale)
            progress.remove_task(task)
            for promise in found:
                word = "passed" if promise.passed else "FAILED"
                console.print(f"{word} ({monotonic() - began:.0f} s)  {promise.claim}: {promise.result}")
            promises += found
    return promises


def main() -> int:
    """Run all tests, or the subjects given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    known = subjects()
    parser.add_argument(
        "--only", choices=list(known), action="append", help="test this subject only; may be repeated"
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed (default 0)")
    parser.add_argument("--short", action="store_true", help="run the short tests of the test suite")
    options = parser.parse_args()
    scale = Scale(options.seed, options.short)
    chosen = options.only or list(known)
    promises = run_all(((name, test) for name in chosen for test in known[name]), scale)
    sys.stdout.write(f"{machine(scale.seed)}\n{table(promises)}\n")
    return 0 if all(each.passed for each in promises) else 1


if __name__ == "__main__":
    sys.exit(main())

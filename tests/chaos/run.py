"""All promises put to the test, as a table; the exit code is 1 if one was not kept.

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
    """What is put to the test, by the name of its file: each has a list of `PROMISES`."""
    found = dict[str, Sequence[Test]]()
    for path in sorted((ROOT / "tests/chaos").glob("*.py")):
        if "PROMISES" in path.read_text() and path.stem != "run" and not path.stem.startswith("test_"):
            found[path.stem] = importlib.import_module(f"tests.chaos.{path.stem}").PROMISES
    return found


def carry_out(test: Test, scale: Scale) -> Sequence[Promise]:
    """What came of one test; one that fails has kept nothing."""
    try:
        kept = test(scale)
    except Exception as error:  # noqa: BLE001 - the others are still to be put to the test
        traceback.print_exc()
        where = f"{test.__module__.rpartition('.')[2]}: {test.__name__}"
        return [Promise(where, f"{type(error).__name__}: {error}"[:200], "a result", kept=False)]
    return [kept] if isinstance(kept, Promise) else kept


def told(tests: Iterable[tuple[str, Test]], scale: Scale) -> list[Promise]:
    """Carry them out, and say meanwhile what is going on."""
    console, kept = Console(stderr=True), list[Promise]()
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        for subject, test in tests:
            summary = (test.__doc__ or "").partition("\n")[0]
            task, began = progress.add_task(f"{subject}: {summary}", total=None), monotonic()
            found = carry_out(test, scale)
            progress.remove_task(task)
            for promise in found:
                word = "kept" if promise.kept else "NOT KEPT"
                console.print(f"{word} ({monotonic() - began:.0f} s)  {promise.claim}: {promise.result}")
            kept += found
    return kept


def main() -> int:
    """Put all to the test, or what is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    known = subjects()
    parser.add_argument("--only", choices=list(known), action="append", help="this subject; may be repeated")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn by chance")
    parser.add_argument("--short", action="store_true", help="as the test suite does it")
    options = parser.parse_args()
    scale = Scale(options.seed, options.short)
    chosen = options.only or list(known)
    kept = told(((name, test) for name in chosen for test in known[name]), scale)
    sys.stdout.write(f"{machine(scale.seed)}\n{table(kept)}\n")
    return 0 if all(each.kept for each in kept) else 1


if __name__ == "__main__":
    sys.exit(main())

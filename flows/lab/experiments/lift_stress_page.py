"""The lift under stress, as a page."""

from pathlib import Path
from typing import Any, Final

from flows.lab.experiments.lift_stress import NOMINAL, Stressed
from flows.lab.experiments.trial_measures import numbers, tried
from flows.report.page import Page, Section, Table, number, terminal_text
from flows.report.report_files import write_page

GOOD: Final = 90.0  # %, of the mean


def page(of: Stressed, command: str) -> Page:
    """The findings; `command` made them."""
    text = (
        f"{tried(of.found[NOMINAL])}, the same under each condition, which differs from nominal in one thing."
    )
    return Page(f"The lift under stress: {of.method}", text, [table(of)], command)


def write(of: Stressed, folder: Path, command: str) -> list[Path]:
    """Write ``lift-stress.html``, ``.md`` and ``.json`` into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    return write_page(page(of, command), summary(of), folder, "lift-stress")


def text(of: Stressed) -> str:
    """What a person reads in a terminal."""
    return terminal_text([table(of)])


def summary(of: Stressed) -> dict[str, Any]:
    """For a program."""
    return of.json()


def table(of: Stressed) -> Section:
    """Success by condition and object."""
    nominal = of.found[NOMINAL]
    head = ["condition", *(thing.replace("_", " ") for thing in nominal.objects), "mean", "slide mm", "force"]
    rows = list[list[str]]()
    for name, found in of.found.items():
        costs = numbers(found, of.method)
        shares = [f"{found.success(of.method, thing):.0f}" for thing in found.objects]
        more = [number(found.mean(of.method)), number(costs["slide_mm"]), number(costs["force_ratio"], 2)]
        rows.append([name, *shares, *more])
    good = sum(found.mean(of.method) >= GOOD for found in of.found.values())
    return Section(
        "lift-stress",
        f"{of.method} holds {GOOD:.0f} % or more under {good} of {len(of.found)} conditions, "
        f"in {tried(nominal)}",
        "Success, %; median slide, and median force over the least that holds, where it is held.",
        [Table(head, rows)],
    )

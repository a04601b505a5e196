"""What an experiment found, as a page, as text for a terminal, and as numbers for a program."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from flows.lab.experiments import trial_figure
from flows.lab.experiments.experiment import Found
from flows.lab.experiments.experiment_tables import best, sections
from flows.lab.experiments.trial_measures import failures, numbers, tried
from flows.learn.evaluation.sample_metrics import known
from flows.report.page import Page, drawn, terminal_text
from flows.report.report_files import write_page


def page(of: Found, command: str) -> Page:
    """The findings; `command` made them."""
    what = "Mallet tap" if of.kind == "tap" else "Object lift"
    text = (
        f"{tried(of)}, the same for all methods, from seed {of.seed} on, in the simulated "
        "scene; the paper's are of real objects. What counts as success, and what is assumed, is in "
        "docs/explanations/experiments.md."
    )
    first, *others = sections(of)
    shown = replace(first, figure=drawn(lambda: trial_figure.example(of)))
    return Page(f"{what}: {best(of)}", text, [shown, *others], command)


def write(of: Found, folder: Path, command: str) -> list[Path]:
    """Write ``tap.html`` or ``lift.html``, ``.md``, ``.json`` and ``.svg`` into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    return write_page(page(of, command), summary(of), folder, of.kind)


def text(of: Found) -> str:
    """What a person reads in a terminal."""
    return terminal_text(sections(of))


def summary(of: Found) -> dict[str, Any]:
    """The same for a program; ``mean_success`` is that of the first method, in %; what is unknown is null."""
    methods = {
        method: {
            "mean_success": of.mean(method),
            "objects": {thing: of.success(method, thing) for thing in of.objects},
            "failures": {thing: failures(of, method, [thing]) for thing in of.objects},
            **{name: known(value) for name, value in numbers(of, method).items()},
        }
        for method in of.methods
    }
    first = methods[of.methods[0]]
    return {
        "experiment": of.kind,
        "trials": of.trials,
        "seed": of.seed,
        "method": of.methods[0],
        "mean_success": first["mean_success"],
        "objects": first["objects"],
        "failures": failures(of, of.methods[0], of.objects),
        "methods": methods,
    }

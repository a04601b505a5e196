"""What an evaluation leaves: one HTML page, the same tables as Markdown, all numbers as JSON."""

from pathlib import Path
from typing import Any

from flows.learn.evaluation import evaluation_sections as sections
from flows.learn.evaluation.evaluation_study import Evaluation
from flows.learn.evaluation.motion_metrics import Cell, Cells
from flows.learn.evaluation.published import SURFACES, TABLE_3
from flows.learn.evaluation.sample_metrics import known
from flows.report.page import Page
from flows.report.report_files import write_page


def page(of: Evaluation, command: str) -> Page:
    """The findings; `command` made them."""
    first = sections.leader(of)
    clean = "Nothing is fitted to them or chosen on them here; what models learnt from is on their cards."
    used = "Methods were fitted to some of them, or settings chosen on them: this is no test."
    text = (
        f"{len(of.results)} methods on the {of.split} split of {of.dataset}: {of.recordings} recordings, "
        f"{of.minutes:.1f} minutes, {of.samples} samples at 100 Hz, split by recording. "
        + (clean if of.split == "test" else used)
    )
    title = f"Slip detectors on {of.dataset}: {first.method.name} reaches {first.confusion.accuracy:.1f} %"
    return Page(title, text, sections.sections(of), command)


def write(of: Evaluation, folder: Path, command: str) -> list[Path]:
    """Write ``evaluation.html``, ``.md`` and ``.json`` and the figures into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    return write_page(page(of, command), summary(of), folder, "evaluation")


def text(of: Evaluation) -> str:
    """What a person reads in a terminal: Table I, what users feel, Table III of the first method."""
    shown = [sections.accuracy(of), sections.users(of), *sections.motions(of), *sections.sliding(of)]
    parts = [part for section in shown for part in (section.title, section.tables[0].markdown())]
    return "\n\n".join([*parts, *(f"not judged: {name}, {reason}" for name, reason in of.missing.items())])


def summary(of: Evaluation) -> dict[str, Any]:
    """All numbers, for a program: shares in %, delays in ms, null where there is none."""
    return {
        "dataset": of.dataset,
        "split": of.split,
        "recordings": of.recordings,
        "samples": of.samples,
        "minutes": round(of.minutes, 3),
        "static": round(of.static, 3),
        "budget": of.budget,
        "seconds": round(of.seconds, 1),
        "methods": {result.method.name: result.summary() for result in of.results},
        "missing": dict(of.missing),
        "motions": {result.method.name: _motions(result.cells) for result in of.results},
        "label_against_sliding": None if of.label is None else round(of.label.accuracy, 3),
    }


def _motions(cells: Cells) -> dict[str, dict[str, float | None]]:
    """F1 by motion and surface."""
    return {
        sections.motion_name(kind, speed): {
            surface: known(cells.at(Cell(kind, speed, surface)).f1, 3) for surface in SURFACES
        }
        for kind, speed in TABLE_3
    }

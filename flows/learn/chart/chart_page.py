"""The chart as a page: its figure, its points, its goals."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from flows.learn.chart import chart_figure
from flows.learn.chart.chart_points import Point
from flows.learn.chart.speed_accuracy import DEFAULT, Chart
from flows.learn.evaluation import published
from flows.report.page import NONE, Page, Section, Table, drawn, number, terminal_text
from flows.report.report_files import write_page


def page(of: Chart, command: str) -> Page:
    """The findings; `command` made them."""
    text = (
        f"{len(of.points)} detectors on the test split of {of.dataset}, {of.recordings} recordings, judged "
        "and timed in one run."
    )
    shown = replace(points(of), figure=drawn(lambda: chart_figure.chart(of.points)))
    return Page(f"Speed against accuracy on {of.dataset}", text, [shown, *goals(of)], command)


def write(of: Chart, folder: Path, command: str) -> list[Path]:
    """Write ``chart.html``, ``.md``, ``.json`` and ``.svg`` into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    return write_page(page(of, command), of.json(), folder, "chart")


def text(of: Chart) -> str:
    """What a person reads in a terminal."""
    return terminal_text([points(of), *goals(of)])


def points(of: Chart) -> Section:
    """All of them, from fast to slow."""
    front = sorted((point for point in of.points if point.pareto), key=lambda point: point.us)
    rows = [_row(point) for point in sorted(of.points, key=lambda point: point.us)]
    rows += [
        [f"paper's {name}", NONE, NONE, number(share), *[NONE] * 6]
        for name, share in published.ACCURACY.items()
    ]
    head = ["detector", "runs on", "us/sample", "accuracy %", "balanced %", "false/min", "missed %",
            "delay ms", "64 fingertips, % of a core", "Pareto front"]  # fmt: skip
    return Section(
        "chart",
        f"None is both faster and more accurate than {_names(front)}",
        "CPU time of one sample of one fingertip, batch 1, one core: a sample where a detector streams, else "
        "a window; by turns in one run, median of the turns. Accuracy by the label. False alarms per static "
        "minute, missed slips and median onset delay are of debounced events; how they are debounced was "
        "chosen on the validation split, or the model's card says it. The paper publishes no speed; its "
        "accuracy is of its own, real test set."
        + "".join(f" Not there: {name}, because {why}." for name, why in of.skipped.items()),
        [Table(head, rows)],
    )


def goals(of: Chart) -> list[Section]:
    """How fast the default detector is, if it is there."""
    reached = of.goals()
    if not reached:
        return []
    rows = [
        [goal.text, f"{'at least' if goal.at_least else 'at most'} {goal.wanted:g}", f"{goal.reached:.3g}",
         "yes" if goal.met else "no"]
        for goal in reached
    ]  # fmt: skip
    met = sum(goal.met for goal in reached)
    return [
        Section(
            "goals",
            f"{DEFAULT} meets {met} of {len(reached)} goals of speed",
            "Torch runs the module that was trained, eagerly; onnxruntime its export; both a window at a "
            "time, on one thread.",
            [Table(["goal", "wanted", "reached", "met"], rows)],
        )
    ]


def _row(point: Point) -> list[str]:
    judged = point.judged
    return [
        point.name,
        "samples" if point.streams else "windows",
        f"{point.us:.3g}",
        number(judged.accuracy),
        number(judged.balanced),
        number(judged.false_alarms_per_min),
        number(judged.missed),
        number(judged.onset_ms).removesuffix(".0"),
        f"{point.core_64:.3g}",
        "yes" if point.pareto else "",
    ]


def _names(points: Sequence[Point]) -> str:
    return ", ".join(point.name for point in points)

"""Report of speed against accuracy: the chart, its points and the goals."""

from typing import Final

from flows.learn.chart import chart_figure
from flows.learn.chart.chart_study import DEFAULT, Chart
from flows.learn.evaluation import published
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value

_RATIOS: Final = {"torch_eager_windowed": 500.0, "onnxruntime_windowed": 50.0}  # times as fast
_CORE: Final = 2.0  # %, of a core, for 64 fingertips


def chart_report(of: Chart, command: str) -> Report:
    """Return the report of a chart that `command` made."""
    text = (
        f"{len(of.points)} detectors on the test split of {of.dataset}, {of.recordings} recordings, "
        "evaluated and timed in one run."
    )
    facts = {"dataset": of.dataset, "recordings": of.recordings, "missing": dict(of.missing)}
    title = f"Speed against accuracy on {of.dataset}"
    return Report(title, text, [points(of), *goals(of)], command, facts)


def points(of: Chart) -> Section:
    """Return the section with all detectors, from fast to slow, and the chart."""
    ordered = sorted(of.points, key=lambda point: point.us)
    front = ", ".join(point.name for point in ordered if point.pareto)
    rows: list[list[Value]] = [
        [each.name, "samples" if each.streams else "windows", each.us, each.performance.accuracy,
         each.performance.balanced, each.performance.false_alarms_per_min, each.performance.missed,
         each.performance.onset_ms, each.core_64, "yes" if each.pareto else None]
        for each in ordered
    ]  # fmt: skip
    rows += [
        [f"paper's {name}", None, None, share, *[None] * 6] for name, share in published.ACCURACY.items()
    ]
    head = ["detector", "runs on", "us/sample", "accuracy %", "balanced %", "false/min", "missed %",
            "delay ms", "64 fingertips, % of a core", "Pareto front"]  # fmt: skip
    return Section(
        "chart",
        f"No detector is both faster and more accurate than {front}",
        "CPU time per sample of one fingertip, batch 1, on one core: a streaming detector processes a "
        "sample, any other a window. The detectors run in turns; the median turn counts. Accuracy by the "
        "label. False alarms per static minute, missed slips and median onset delay are of debounced events, "
        "with the settings of the model card or those tuned on the validation split. The paper publishes no "
        "speed; its accuracy is of its own, real test set."
        + "".join(f" Missing: {name}, {why}." for name, why in of.missing.items()),
        [Table(head, rows, decimals={"us/sample": None, "delay ms": 0, "64 fingertips, % of a core": None})],
        lambda: chart_figure.chart(of.points),
    )


def goals(of: Chart) -> list[Section]:
    """Return the section with the speed goals of the default detector; [] if it was not measured."""
    points = {point.name: point for point in of.points}
    if DEFAULT not in points:
        return []
    default = points[DEFAULT]
    reached = [
        (f"{DEFAULT}: times faster than {name}", wanted, points[name].us / default.us)
        for name, wanted in _RATIOS.items()
    ]
    met = [*(ratio >= wanted for _, wanted, ratio in reached), default.core_64 <= _CORE]
    reached.append(("64 fingertips at 100 Hz, % of a core", _CORE, default.core_64))
    rows: list[list[Value]] = [
        [text, f"{'at most' if wanted == _CORE else 'at least'} {wanted:g}", value, "yes" if good else "no"]
        for (text, wanted, value), good in zip(reached, met, strict=True)
    ]
    return [
        Section(
            "goals",
            f"{DEFAULT} meets {sum(met)} of {len(met)} speed goals",
            "PyTorch runs the trained module in eager mode, onnxruntime its ONNX export; both process one "
            "window at a time on one thread.",
            [Table(["goal", "wanted", "reached", "met"], rows, decimals={"reached": None})],
        )
    ]

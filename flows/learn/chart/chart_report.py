"""Report of speed against accuracy: the chart, its points and the goals."""

from typing import Final

from flows.learn.chart import chart_figure
from flows.learn.chart.chart_study import DEFAULT, Chart
from flows.learn.evaluation import published
from flows.learn.evaluation.target_table import TARGET_DECIMALS, target_cells, target_head
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, counted

_RATIOS: Final = {"torch_eager_windowed": 500.0, "onnxruntime_windowed": 50.0}  # times as fast
_DECIMALS: Final = {"us/sample": None, "64 fingertips, % of a core": None}
_CORE: Final = 2.0  # %, of a core, for 64 fingertips


def chart_report(of: Chart, command: str) -> Report:
    """Return the report of a chart that `command` made."""
    text = (
        f"{counted(len(of.points), 'detector')} on the test split of {of.dataset}, "
        f"{counted(of.recordings, 'recording')}, evaluated and timed in one run."
    )
    facts = {"dataset": of.dataset, "recordings": of.recordings, "missing": dict(of.missing)}
    title = f"Speed against accuracy on {of.dataset}"
    return Report(title, text, [points(of), *goals(of)], command, facts)


def points(of: Chart) -> Section:
    """Return the section with all detectors, from fast to slow, and the chart."""
    ordered = sorted(of.points, key=lambda point: point.us)
    front = ", ".join(point.name for point in ordered if point.pareto)
    rows: list[list[Value]] = [
        [each.name, "samples" if each.streams else "windows", each.us, each.core_64,
         "yes" if each.pareto else None, each.performance.accuracy, *target_cells(each.performances)]
        for each in ordered
    ]  # fmt: skip
    compared = target_head(ordered[0].performances)
    rows += [
        [f"paper's {name}", *[None] * 4, share, *[None] * len(compared)]
        for name, share in published.ACCURACY.items()
    ]
    head = ["detector", "runs on", "us/sample", "64 fingertips, % of a core", "Pareto front", "accuracy %",
            *compared]  # fmt: skip
    return Section(
        "chart",
        f"No detector is both faster and more accurate than {front}",
        "CPU time per sample of one fingertip, batch 1, on one core: a streaming detector processes a "
        "sample, any other a window. The detectors run in turns; the median turn counts. Accuracy by the "
        "arm-speed label. False alarms per static minute, missed slips and median onset delay are of "
        "debounced events against the slips of each target (true sliding is known in simulation only), with "
        "the settings of the model card or those tuned on the validation split. Lead: median time from an "
        "onset to the change of the arm-speed label. The paper publishes no speed; its accuracy is of its "
        "own, real test set." + "".join(f" Missing: {name}, {why}." for name, why in of.missing.items()),
        [Table(head, rows, decimals={**TARGET_DECIMALS, **_DECIMALS})],
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
    reached.append((f"64 fingertips at {default.rate:g} Hz, % of a core", _CORE, default.core_64))
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

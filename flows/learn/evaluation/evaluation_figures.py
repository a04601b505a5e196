"""Figures of an evaluation."""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from typing import Final

import numpy as np

from flows.learn.evaluation.evaluation_study import MethodResult
from flows.learn.evaluation.motion_metrics import MotionConfusions, MotionKind
from flows.learn.evaluation.published import SPEEDS, SURFACES, TABLE_3
from flows.learn.evaluation.sample_metrics import EDGES
from flows.report.figures import CELLS, FAINT, MAIN, SECOND, WIDTH, Axes, Figure, grid, name_points, styled

_LINES: Final = ("-", "--", ":")
_COLUMNS: Final = 5  # confusion matrices in a row
_LATEST: Final = 300  # ms, delays that are shown


@styled
def confusions(results: Sequence[MethodResult]) -> Figure:
    """Draw the confusion matrices."""
    columns = min(len(results), _COLUMNS)
    rows = -(-len(results) // columns)
    figure, axes = grid(rows, columns, (WIDTH / _COLUMNS * columns, 0.4 + 2.3 * rows))
    for axis, result in zip(axes, results, strict=False):
        counts = result.confusion.counts
        share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)  # of each truth
        for truth in range(2):
            for prediction in range(2):
                number = f"{100 * share[truth, prediction]:.1f} %\n{int(counts[truth, prediction])}"
                axis.axhspan(truth - 0.5, truth + 0.5, prediction / 2, (prediction + 1) / 2, color=MAIN,
                             alpha=0.06 + 0.34 * share[truth, prediction], linewidth=0)  # fmt: skip
                axis.text(prediction, truth, number, ha="center", va="center")
        axis.set(title=result.method.name, xlim=(-0.5, 1.5), ylim=(1.5, -0.5), aspect="equal")
        axis.set_xticks([0, 1], ["static", "slip"])
        axis.set_yticks([0, 1], ["static", "slip"])
        axis.tick_params(length=0)
        for spine in axis.spines.values():
            spine.set_visible(False)
    for axis in axes[len(results) :]:
        axis.set_axis_off()
    axes[0].set_ylabel("label")
    figure.supxlabel("prediction")
    return figure


@styled
def curves(results: Sequence[MethodResult]) -> Figure:
    """Draw ROC and reliability."""
    figure, (roc, reliability) = grid(1, 2, (WIDTH, 4.6))
    for result, look in _styles(results):
        curve = result.roc
        label = f"{result.method.name}  {100 * curve.area:.1f}"
        roc.plot(100 * curve.false, 100 * curve.true, label=label, **look)
        predicted, slip = 100 * result.reliability.probability, 100 * result.reliability.slip
        label = f"{result.method.name}  {result.reliability.error:.1f}"
        reliability.plot(predicted, slip, marker="o", markersize=3, label=label, **look)
    for axis in (roc, reliability):
        axis.plot([0, 100], [0, 100], color=FAINT, linewidth=0.8, zorder=0)
        axis.set(xlim=(0, 100), ylim=(0, 100))
    roc.set(title="ROC", xlabel="static predicted as slip, %", ylabel="slip predicted as slip, %")
    roc.legend(title="area under the curve, %", loc="lower right")
    reliability.set(title="Reliability", xlabel="probability of slip, %", ylabel="share of slip, %")
    reliability.legend(title="calibration error, %", loc="upper left")
    return figure


@styled
def delays(results: Sequence[MethodResult]) -> Figure:
    """Draw the share of detected slips by delay, and delay against false alarms."""
    figure, (found, cost) = grid(1, 2, (WIDTH, 4.4), widths=[1.6, 1])
    for result, look in _styles(results):
        events = result.events
        late = np.sort(events.delays)  # (caught,) ms
        late = late[late <= _LATEST]
        share = 100 * np.arange(len(late) + 1) / max(events.slips, 1)
        found.step([-50, *late, _LATEST], [*share, share[-1]], where="post", label=result.method.name, **look)
        cost.plot(events.false_alarms_per_min, events.onset_ms, "o", color=look["color"], markersize=6)
    costs = {each.method.name: (each.events.false_alarms_per_min, each.events.onset_ms) for each in results}
    most = max([1.0, *(alarms for alarms, _ in costs.values() if isfinite(alarms))])
    found.axvline(0, color=FAINT, linewidth=0.8)
    found.set(title="Slips with an onset", xlabel="ms after the label changes to slip", ylabel="slips, %",
              xlim=(-50, _LATEST), ylim=(0, 100))  # fmt: skip
    found.yaxis.grid(visible=True)
    found.legend(loc="lower right")
    cost.set(title="Delay against false alarms", xlabel="false alarms per static minute",
             ylabel="median delay, ms", xlim=(-0.03 * most, 1.5 * most),
             ylim=(min(0, cost.get_ylim()[0]), None))  # fmt: skip
    name_points(cost, [(name, *at) for name, at in costs.items() if isfinite(at[1])], (3.6, 3.6))
    cost.yaxis.grid(visible=True)
    return figure


@styled
def changes(results: Sequence[MethodResult]) -> Figure:
    """Draw accuracy and errors by distance from the nearest change of the label."""
    figure, (axis, errors) = grid(2, 1, (8, 6.4))
    places = np.arange(len(EDGES))
    for result, look in _styles(results):
        axis.plot(places, result.changes.accuracy, marker="o", markersize=3, label=result.method.name, **look)
        wrong = result.changes.errors
        share = 100 * wrong.cumsum() / max(wrong.sum(), 1)
        errors.plot(places, share, label=result.method.name, **look)
    names = [*results[0].changes.spans, f"{EDGES[-1]}-"]
    for each in (axis, errors):
        each.set_xticks(places, names)
        each.set(xlabel="ms to the nearest change of the label")
        each.yaxis.grid(visible=True)
    axis.set(title="Accuracy", ylabel="%", ylim=(None, 100))
    errors.set(title="Cumulative errors", ylabel="% of all errors", ylim=(0, 100))
    errors.legend(loc="lower right")
    return figure


@styled
def motion(found: Mapping[str, MotionConfusions]) -> Figure:
    """Draw the F1 of the paper's Table III for up to two detectors."""
    figure, axes = grid(1, len(SURFACES), (WIDTH, 3.4), sharey=True)
    rotation = len(SPEEDS)  # place of rotation
    styles = dict(zip(found, ((MAIN, "o"), (SECOND, "s")), strict=False))
    for column, (axis, surface) in enumerate(zip(axes, SURFACES, strict=True)):
        for kind, line in (("primary", "-"), ("oblique", ":")):
            paper = [TABLE_3[kind, speed][column] for speed in SPEEDS]
            axis.plot(range(rotation), paper, line, color=FAINT, label=f"paper, {kind}")
            for name, cells in found.items():
                colour, mark = styles[name]
                values = [cells.at(MotionKind(kind, speed, surface)).f1 for speed in SPEEDS]
                label = f"{name}, {kind}"
                axis.plot(range(rotation), values, line, marker=mark, markersize=4, color=colour, label=label)
        axis.plot(rotation, TABLE_3["rotation", None][column], "D", color=FAINT, markersize=5)
        for name, cells in found.items():
            colour, mark = styles[name]
            axis.plot(
                rotation, cells.at(MotionKind("rotation", None, surface)).f1, mark, color=colour, markersize=5
            )
        axis.set(title=surface.replace("_", " "), xlabel="cm/s, or rotation")
        axis.set_xticks(range(rotation + 1), [*(f"{100 * speed:g}" for speed in SPEEDS), "rot."])
        axis.yaxis.grid(visible=True)
    axes[0].set_ylabel("F1, %")
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower left", ncols=3)
    return figure


def _styles(results: Sequence[MethodResult]) -> Iterator[tuple[MethodResult, dict[str, Axes]]]:
    """Yield each result with a colour and a line style of its own."""
    for number, result in enumerate(results):
        colour, line = CELLS[number % len(CELLS)], _LINES[number // len(CELLS) % len(_LINES)]
        yield result, {"color": colour, "linestyle": line}

"""Figures of a benchmark."""

from typing import Final

import numpy as np

from flows.learn.benchmark.benchmark_study import DatasetResult
from flows.report.figures import CELLS, FAINT, WIDTH, Axes, Figure, grid, name_points, styled

_HEIGHT: Final = 0.24  # inches per row
_CHANCE: Final = 50  # %
_TICKS: Final = (0, 0.5, 1, 2, 5, 10, 20, 50, 100)  # false alarms per static minute


@styled
def overview(of: DatasetResult) -> Figure:
    """Draw balanced accuracy with its interval, and that of each fold, for each detector and regime."""
    rows = of.results[::-1]
    figure, (axis,) = grid(1, 1, (8.5, 1.2 + _HEIGHT * len(rows)))
    regimes = list(dict.fromkeys(each.entrant.regime for each in of.results))
    for place, each in enumerate(rows):
        color = CELLS[regimes.index(each.entrant.regime)]
        found = each.figures.balanced
        folds = list(each.by_fold.values())
        axis.plot(folds, np.full(len(folds), place), "|", color=color, markersize=7, alpha=0.7)
        if found.interval():
            axis.plot([found.low, found.high], [place, place], color=color, linewidth=3, alpha=0.35)
        axis.plot(found.value, place, "o", color=color, markersize=5)
    axis.axvline(_CHANCE, color=FAINT, linewidth=0.8)
    axis.set_yticks(range(len(rows)), [each.entrant.title for each in rows])
    axis.set(
        title=of.data.name,
        xlabel=f"balanced accuracy, %; ticks: each {of.data.by} held out",
        xlim=(None, 100),
    )
    axis.xaxis.grid(visible=True)
    return figure


@styled
def events(of: DatasetResult) -> Figure:
    """Draw missed slips and delay against false alarms."""
    figure, (missed, delay) = grid(1, 2, (WIDTH, 4.2))
    regimes = list(dict.fromkeys(each.entrant.regime for each in of.results))
    named: dict[Axes, list[tuple[str, float, float]]] = {missed: [], delay: []}
    for each in of.results:
        color, found = CELLS[regimes.index(each.entrant.regime)], each.figures
        for axis, value in ((missed, found.missed.value), (delay, found.delay.value)):
            alarms = found.false_alarms_per_min.value
            if np.isfinite(value) and np.isfinite(alarms):
                axis.plot(alarms, value, "o", color=color, markersize=5)
                named[axis].append((each.entrant.name, alarms, value))
    missed.set(title="Missed slips", ylabel="slips without an event, %", ylim=(0, 105))
    delay.set(title="Delay of events", ylabel="median from the start of the slip, ms")
    for axis in (missed, delay):
        most = max([1.0, *(alarms for _, alarms, _ in named[axis])])
        axis.set_xscale("symlog", linthresh=1)
        axis.set_xticks(_TICKS, [f"{tick:g}" for tick in _TICKS])
        axis.minorticks_off()
        axis.set(xlabel="false alarms per static minute; logarithmic above 1", xlim=(-0.15, 4 * most))
        axis.yaxis.grid(visible=True)
        name_points(axis, named[axis], (4.6, 3.5))
    for regime, color in zip(regimes, CELLS, strict=False):
        missed.plot([], [], "o", color=color, label=regime)
    figure.legend(*missed.get_legend_handles_labels(), loc="outside upper left", ncols=len(regimes))
    return figure

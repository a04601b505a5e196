"""Success and slide against added delay, one line an object, and where the budget is spent."""

import math
from typing import Final

import numpy as np

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.lift_ablation import GOOD, Ablation
from flows.lab.experiments.lifting import LAGS, LIFT
from flows.lab.experiments.trial_measures import median
from flows.report.figures import CELLS, FAINT, INK, Axes, Figure, grid, styled

COLOURS: Final = dict(zip(OBJECTS, CELLS, strict=True))  # by object
MARKS: Final = dict(zip(OBJECTS, "soD^vP", strict=True))


@styled
def panels(of: Ablation, title: str) -> Figure:
    """A column for each method; success above, slide below."""
    from matplotlib.lines import Line2D  # noqa: PLC0415 - an extra, and slow to import

    columns = len(of.methods)
    figure, axes = grid(2, columns, (4.6 * columns + 0.4, 6.4), sharex=True)
    for column, method in enumerate(of.methods):
        above, below = axes[column], axes[columns + column]
        for thing in of.nominal.objects:
            _line(of, method, thing, above, below)
        _limits(of, method, below)
        above.axhline(GOOD, color=FAINT, linestyle="--", linewidth=0.8, zorder=0)
        above.set(ylim=(-4, 112), title=f"{method}: success, %")
        below.set(ylim=(0, 52), title="median slide, mm", xlabel="added delay, ms")
        for axis in (above, below):
            axis.yaxis.grid(visible=True)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(
        [*handles, Line2D([], [], color=INK, marker="v", linestyle="none")],
        [*names, "predicted limit"],
        loc="outside lower center",
        ncols=7,
    )
    figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return figure


def _line(of: Ablation, method: str, thing: str, above: Axes, below: Axes) -> None:
    """An object's, with a mark above where one trial in ten should have spent its budget."""
    delays = list(of.delays)
    style = {"color": COLOURS[thing], "marker": MARKS[thing], "markersize": 3.5}
    name = thing.replace("_", " ")
    above.plot(delays, [each.success(method, thing) for each in of.delays.values()], label=name, **style)
    slides = [
        np.median([each.slide for each in of.lifts(found, method, thing)]) for found in of.delays.values()
    ]
    below.plot(delays, slides, **style)
    limit = of.predicted(method, thing)
    if math.isfinite(limit):
        above.plot(
            limit, 106, marker="v", color=COLOURS[thing], markersize=6, linestyle="none", clip_on=False
        )


def _limits(of: Ablation, method: str, below: Axes) -> None:
    """What the hand has climbed by then, and how far is too far."""
    lifts = (each for thing in of.nominal.objects for each in of.lifts(of.nominal, method, thing))
    firm = median([each.firm for each in lifts if each.firm > 0])  # s
    delays = np.linspace(0, max(of.delays), 200)
    climbed = 1000 * LIFT.climbed(LIFT.instant + firm + delays / 1000)
    below.plot(delays, climbed, color=INK, linestyle=":", linewidth=1, zorder=0)
    below.text(
        0.98, 0.05, "dotted: what the hand climbs until it grips with what holds",
        transform=below.transAxes, ha="right", fontsize=7,
    )  # fmt: skip
    below.axhline(1000 * LAGS, color=FAINT, linestyle="--", linewidth=0.8, zorder=0)
    below.annotate("counts as held", (0, 1000 * LAGS), (0, 2), textcoords="offset points", fontsize=7)

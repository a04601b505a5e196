"""Figures of an evaluation: accuracy and events of all methods, speed against accuracy, and stress."""

from collections.abc import Collection
from typing import Final

import numpy as np
import polars as pl

from flows.learn.evaluation.published import TABLE_1
from flows.learn.evaluation.stress_study import FIELDS, condition_name
from flows.report.figures import FAINT, GROUND, MAIN, MORE, SOFT, WIDTH, Figure, grid

_COLUMNS: Final = 4  # panels in a row
_MARKS: Final = "osD^vP*X"
_TICKS: Final = (50, 60, 70, 80, 85, 90, 92, 94, 96, 98, 99)  # %


def pareto_front(points: pl.DataFrame) -> list[str]:
    """Return the methods that no other one beats in both speed and accuracy, from fast to slow.

    Args:
        points: Columns ``method``, ``us/sample`` and ``accuracy %``.
    """
    ordered = points.drop_nulls("accuracy %").sort("us/sample", "accuracy %", descending=[False, True])
    best_so_far = pl.col("accuracy %").cum_max().shift(fill_value=-np.inf)
    return ordered.filter(pl.col("accuracy %") > best_so_far)["method"].to_list()


def chart(points: pl.DataFrame, front: Collection[str]) -> Figure:
    """Draw accuracy over CPU time, with the Pareto front and the paper's accuracy.

    Args:
        points: Columns ``method``, ``us/sample`` and ``accuracy %``, from fast to slow; some are known.
        front: Methods on the Pareto front, which are filled.
    """
    figure, (axis,) = grid(1, 1, (WIDTH, 5.6))
    errors = points.select("method", "us/sample", 100 - pl.col("accuracy %")).drop_nulls()
    rows = errors.rows()
    low, high = min(us for _, us, _ in rows) / 2, max(us for _, us, _ in rows) * 4
    shown = [*(100 - each for each in TABLE_1.values()), *(error for *_, error in rows)]  # errors, %
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter("")
    axis.set_yscale("log")
    axis.set_yticks([100 - tick for tick in _TICKS], _TICKS)
    axis.yaxis.minorticks_off()
    axis.set(
        xlim=(low, high),
        ylim=(max(shown) + 4, max(min(shown) - 1, 0.5)),
        xlabel="CPU us per sample, batch 1, one core",
        ylabel="accuracy, % (logarithmic scale of the error)",
        title="Speed against accuracy",
    )
    best = [(us, error) for name, us, error in rows if name in front]
    steps = [*best, (high, best[-1][1])]
    axis.plot(*zip(*steps, strict=True), color=MAIN, drawstyle="steps-post", alpha=0.5, label="Pareto front")
    for name, accuracy in TABLE_1.items():
        axis.axhline(100 - accuracy, color=FAINT, linestyle=(0, (4, 3)), linewidth=0.9, zorder=0)
        axis.annotate(f"paper's {name}, {accuracy:g} %", (1, 100 - accuracy), (-2, 2), color=SOFT,
                      xycoords=("axes fraction", "data"), textcoords="offset points", ha="right")  # fmt: skip
    axis.grid(visible=True)
    axis.set_axisbelow(True)
    for place, (name, us, error) in enumerate(rows):
        colour = MORE[place % len(MORE)]
        fill = colour if name in front else GROUND
        axis.plot(us, error, "o", color=colour, markerfacecolor=fill, linestyle="", label=name)
    figure.legend(*axis.get_legend_handles_labels(), loc="outside right upper")
    return figure


def stress_panels(balanced: pl.DataFrame) -> Figure:
    """Draw the balanced accuracy of each method along each stress field, from nominal to the last level.

    Args:
        balanced: Estimates by condition and method.
    """
    names = balanced["method"].unique(maintain_order=True).to_list()
    heights = {(row[0], row[1]): row[2] for row in balanced.select("condition", "method", "value").rows()}
    rows = -(-len(FIELDS) // _COLUMNS)
    figure, axes = grid(rows, _COLUMNS, (WIDTH, 2.1 * rows), sharey=True)
    for axis, (field, values) in zip(axes, FIELDS.items(), strict=False):
        shown = sorted(values.values) if min(values.values) < values.nominal else list(values.values)
        for place, name in enumerate(names):
            line = [(at, heights.get((condition_name(field, each), name))) for at, each in enumerate(shown)]
            axis.plot(
                *zip(*((at, height) for at, height in line if height is not None), strict=True),
                marker=_MARKS[place // len(MORE) % len(_MARKS)],
                markersize=3,
                color=MORE[place % len(MORE)],
                linewidth=2 if place == 0 else 1,
                label=name,
                zorder=len(names) - place + 2,
            )
        axis.axvline(shown.index(values.nominal), color=FAINT, linewidth=0.8, zorder=0)
        axis.set_xticks(range(len(shown)), [values.number(value) for value in shown])
        axis.set(xlim=(-0.4, len(shown) - 0.6), ylim=(45, 100))
        axis.set_title(f"{values.text}, {values.unit}" if values.unit else values.text)
        axis.yaxis.grid(visible=True)
    for axis in axes[len(FIELDS) :]:
        axis.set_axis_off()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=min(len(names), 6))
    figure.supylabel("balanced accuracy, %")
    return figure

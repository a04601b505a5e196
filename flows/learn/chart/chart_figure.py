"""Figure of speed against accuracy, and of delay against false alarms."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flows.learn.chart.chart_study import Point
from flows.learn.evaluation import published
from flows.report.figures import (
    FAINT,
    GROUND,
    INK,
    MAIN,
    SECOND,
    SOFT,
    WIDTH,
    Axes,
    Figure,
    grid,
    name_points,
    styled,
)

_SIZE: Final = (WIDTH, 5.6)  # inches
_PANEL: Final = (4.8, 4.4)  # inches, about
_TICKS: Final = (50, 60, 70, 80, 85, 90, 92, 94, 96, 98, 99)  # %
_ZERO: Final = 0.2  # false alarms that stand for 0 on the logarithmic axis


@styled
def chart(points: Sequence[Point]) -> Figure:
    """Draw accuracy over CPU time, and false alarms over onset delay."""
    figure, (speed, onsets) = grid(1, 2, _SIZE, widths=[1.2, 1])
    _speed(speed, points)
    _onsets(onsets, [point for point in points if not point.same])
    handles, names = speed.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=3)
    return figure


def _speed(axis: Axes, points: Sequence[Point]) -> None:
    low, high = min(point.us for point in points) / 2, max(point.us for point in points) * 8
    values = [*published.ACCURACY.values(), *(point.performance.accuracy for point in points)]
    bottom, top = _stretch([min(values) - 4, min(max(values) + 1, 99.5)])
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_yscale("function", functions=(_stretch, _shrink))
    axis.set_yticks([tick for tick in _TICKS if bottom <= _stretch([tick])[0] <= top])
    axis.set(
        xlim=(low, high),
        ylim=_shrink([bottom, top]),
        xlabel="CPU us per sample, batch 1, one core",
        ylabel="accuracy, % (logarithmic scale of the error)",
        title="Speed against accuracy",
    )
    front = sorted((point for point in points if point.pareto), key=lambda point: point.us)
    axis.plot(
        [*(point.us for point in front), high],
        [*(point.performance.accuracy for point in front), front[-1].performance.accuracy],
        color=MAIN,
        drawstyle="steps-post",
        alpha=0.5,
        zorder=1,
        label="Pareto front",
    )
    for name, accuracy in published.ACCURACY.items():
        axis.axhline(accuracy, color=FAINT, linestyle=(0, (4, 3)), linewidth=0.9, zorder=0)
        axis.annotate(f"paper's {name}, {accuracy:g} %", (1, accuracy), (-2, 2), color=SOFT,
                      xycoords=("axes fraction", "data"), textcoords="offset points", ha="right")  # fmt: skip
    _draw(axis, [(point, point.us, point.performance.accuracy) for point in points])
    for marker, text in (("o", "sample by sample"), ("s", "on windows")):
        axis.plot([], [], marker, color=INK, markerfacecolor=GROUND, label=text)


def _onsets(axis: Axes, points: Sequence[Point]) -> None:
    points = [point for point in points if not math.isnan(point.performance.onset_ms)]
    alarms = np.array([max(point.performance.false_alarms_per_min, _ZERO) for point in points])
    delays = np.array([point.performance.onset_ms for point in points])
    low, high = min([*alarms, 1.0]) / 1.5, max([*alarms, 4.0]) * 1.5
    left, right = min([*delays, 0.0]) - 10, max([*delays, 100.0]) * 1.3
    axis.set_yscale("log")
    ticks = [tick for tick in (_ZERO, 0.5, 1, 2, 5, 10, 20, 50, 100) if low <= tick <= high]
    axis.set_yticks(ticks, ["0" if tick == _ZERO else f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    axis.set(
        xlim=(left, right),
        ylim=(low, high),
        xlabel="median onset delay, ms",
        ylabel="false alarms per static minute",
        title="Delay against false alarms",
    )
    _draw(axis, [*zip(points, delays.tolist(), alarms.tolist(), strict=True)])


def _draw(axis: Axes, marks: Sequence[tuple[Point, float, float]]) -> None:
    """Draw points at x and y with their names."""
    axis.grid(visible=True)
    axis.set_axisbelow(True)
    for point, x, y in marks:
        colour = MAIN if point.pareto else SECOND if point.same else INK
        axis.plot(x, y, "o" if point.streams else "s", color=colour, markersize=6,
                  markerfacecolor=colour if point.pareto else GROUND)  # fmt: skip
    name_points(axis, [(point.name, x, y) for point, x, y in marks], _PANEL)


def _stretch(accuracy: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert accuracy, %, to minus the logarithm of the error, %."""
    return -np.log(np.maximum(100 - np.asarray(accuracy, np.float64), 0.1))


def _shrink(stretched: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert back to accuracy, %; the inverse of `_stretch`."""
    return 100 - np.exp(-np.asarray(stretched, np.float64))

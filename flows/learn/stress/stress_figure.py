"""Figures of stresses: one panel per field."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from typing import Final

from flows.learn.labelled_recordings import Target
from flows.learn.stress.stress_fields import FIELDS, StressField
from flows.learn.stress.stress_study import Stress
from flows.report.colours import light
from flows.report.figures import CELLS, FAINT, INK, SECOND, WIDTH, Axes, Figure, grid, styled

_COLUMNS: Final = 4
_COLOURS: Final = (*CELLS, SECOND, INK, *map(light, ("teal", "olive", "steel")), FAINT)
_MARKS: Final = "osD^vP*X"
_POWERS: Final = (0, 1, 10, 100)  # labels of a logarithmic axis
_LATEST: Final = 400.0  # ms, delays that are shown


@dataclass(frozen=True, slots=True)
class Measure:
    """Measure that is drawn along the fields."""

    key: str  # field of `Performance`
    text: str  # label of the axis
    limits: tuple[float, float]
    log: bool = False  # logarithmic axis, linear near 0


MEASURES: Final[Mapping[str, Measure]] = {
    measure.key: measure
    for measure in (
        Measure("balanced", "balanced accuracy, %", (45, 100)),
        Measure("false_alarms_per_min", "false alarms / static min", (0, 150), log=True),
        Measure("missed", "missed slips, %", (-4, 104)),
        Measure("onset_ms", "median onset delay, ms", (-50, _LATEST)),
    )
}
_Line = tuple[str, Callable[[str, float], float]]  # its name; its height at a field's value


@styled
def panels(of: Stress, measure: Measure, target: Target = "arm-speed") -> Figure:
    """Draw a measure of each detector along each field."""

    def line(name: str) -> _Line:
        return name, lambda field, value: getattr(of.at(name, field, value, target), measure.key)

    figure, axes = _panels([line(name) for name in of.names], measure.text)
    for axis in axes:
        axis.set(ylim=measure.limits)
        if measure.log:
            axis.set_yscale("symlog", linthresh=1)
            axis.set_yticks(_POWERS, [str(power) for power in _POWERS])
            axis.minorticks_off()
    return figure


@styled
def abstention(of: Stress) -> Figure:
    """Draw the shares of samples during which a fault is reported, and without a score."""
    first = of.names[0]
    lines: Sequence[_Line] = (
        ("a fault is reported", lambda field, value: of.outcome(field, value).degraded),
        ("no score", lambda field, value: of.outcome(field, value).unscored[first]),
    )
    figure, axes = _panels(lines, "samples, %")
    for axis in axes:
        axis.set(ylim=(-4, 104))
    return figure


def _panels(lines: Sequence[_Line], text: str) -> tuple[Figure, list[Axes]]:
    """Draw values from nominal to broken, or from the lowest to the highest if there are two sides."""
    rows = -(-len(FIELDS) // _COLUMNS)
    figure, axes = grid(rows, _COLUMNS, (WIDTH, 2.1 * rows), sharey=True)
    for number, (axis, (field, values)) in enumerate(zip(axes, FIELDS.items(), strict=False)):
        shown = sorted(values.values) if len(values.sides) > 1 else list(values.values)
        for place, (name, height) in enumerate(lines):
            heights = [height(field, value) for value in shown]
            axis.plot(
                [at for at, each in enumerate(heights) if not isnan(each)],
                [each for each in heights if not isnan(each)],
                marker=_MARKS[place // len(_COLOURS) % len(_MARKS)],
                markersize=3,
                color=_COLOURS[place % len(_COLOURS)],
                linewidth=2 if place == 0 else 1,
                label=name,
                zorder=len(lines) - place + 2,
            )
        _scale(axis, values, shown)
        if number % _COLUMNS == 0:
            axis.set_ylabel(text)
    for axis in axes[len(FIELDS) :]:
        axis.set_axis_off()
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=min(len(names), 6))
    return figure, axes[: len(FIELDS)]


def _scale(axis: Axes, values: StressField, shown: Sequence[float]) -> None:
    axis.axvline(shown.index(values.values[0]), color=FAINT, linewidth=0.8, zorder=0)
    axis.set_xticks(range(len(shown)), [values.number(value) for value in shown])
    axis.set(xlim=(-0.4, len(shown) - 0.6))
    title = f"{values.text}, {values.unit}" if values.unit else values.text
    axis.set_title(title)
    axis.yaxis.grid(visible=True)

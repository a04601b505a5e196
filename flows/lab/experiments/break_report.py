"""Report of where each method breaks, along friction, mass, latency, rate, stiffness and the pad."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import polars as pl

from flows.lab.experiments.gripper_model import GripperModel
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.study import NOMINAL, Study
from flows.lab.experiments.study_report import FALSE_FIRM, SUCCESS, TITLES, interval, study_facts
from flows.lab.experiments.trial import Conditions
from flows.report.figures import CELLS, FAINT, WIDTH, Figure, grid, styled
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value

GOOD: Final = 90.0  # %; a lower success counts as broken
_COLUMNS: Final = 3  # panels in a row of the figure


def _factors(name: str, *factors: float) -> dict[str, Conditions]:
    """Return a condition for each factor of a setting, which is nominal at 1."""
    values: dict[float, Mapping[str, Any]] = {factor: {name: factor} for factor in factors}
    return {f"x{factor:g}": Conditions(**values[factor]) for factor in factors}


AXES: Final[Mapping[str, Mapping[str, Conditions]]] = {  # nominal comes after those below it
    "friction": _factors("friction", 0.5, 0.75, 1, 1.5, 2),
    "mass": _factors("mass", 0.5, 1, 1.5, 2),
    "latency": {
        f"+{delay} ms": Conditions(gripper=replace(GripperModel(), delay=delay / 1000))
        for delay in (0, 50, 100, 200, 300)
    },
    "rate": {f"{rate:g} Hz": Conditions(rate=rate) for rate in (25.0, 50.0, 100.0, 200.0)},
    "stiffness": _factors("stiffness", 0.5, 1, 2, 4),
    "pad": _factors("tilt", 0.5, 1, 2, 4),
}
TEXTS: Final = {
    "friction": "Factor of all friction coefficients.",
    "mass": "Factor of the object's mass.",
    "latency": "Delay added between a command and the gripper.",
    "rate": "Sample rate. The detectors were trained at 100 Hz and take each sample for 10 ms.",
    "stiffness": "Factor of the normal stiffness of the contact.",
    "pad": "Factor of the tilt stiffness of the pad, which no method was tuned for.",
}


def axes_of(experiment: str) -> Mapping[str, Mapping[str, Conditions]]:
    """Return the axes of an experiment; the force of a tap is constant, so it has no latency."""
    return {name: each for name, each in AXES.items() if experiment == "lift" or name != "latency"}


def conditions_of(experiment: str) -> dict[str, Conditions]:
    """Return all distinct conditions of an experiment by name."""
    varied = {
        f"{axis} {name}": each
        for axis, values in axes_of(experiment).items()
        for name, each in values.items()
        if each != Conditions()
    }
    return {NOMINAL: Conditions(), **varied}


def break_report(study: Study, command: str) -> Report:
    """Report an experiment under all its conditions, which `command` ran."""
    axes = axes_of(study.name)
    sections = [_axis(study, axis) for axis in axes]
    sections[0] = replace(sections[0], draw=lambda: figure(study))
    nominal = study.of(study.methods[0]).filter(condition=NOMINAL)
    breaks = {str(method): {axis: _broken(study, method, axis) for axis in axes} for method in study.methods}
    text = (
        f"{study.trials}, the same under each condition and for each method. One setting differs from "
        f"nominal. A method breaks where its success falls below {GOOD:.0f} %. CI: Wilson's 95 % interval of "
        "the success. False: share of firm lifts with a registered slip, %."
    )
    facts = {**study_facts(study, nominal), "breaks": breaks}
    return Report(f"{TITLES[study.name]}: where each method breaks", text, sections, command, facts)


def _axis(study: Study, axis: str) -> Section:
    """Return the section about an axis: a row for each value and method."""
    rows: list[list[Value]] = []
    for value, outcomes in _along(study, axis).items():
        for method in study.methods:
            one = outcomes.filter(method=str(method))
            success, false = one.select(SUCCESS, FALSE_FIRM).row(0)
            rows.append([value, str(method), success, interval(int(one["success"].sum()), len(one)), false])
    found = [(method, _broken(study, method, axis)) for method in study.methods]
    finding = "; ".join(
        f"{method} breaks {'at ' + ', '.join(broken) if broken else 'nowhere'}" for method, broken in found
    )
    table = Table([axis, "method", "success %", "95 % CI", "false %"], rows)
    return Section(axis, f"{axis.capitalize()}: {finding}", TEXTS[axis], [table])


def _along(study: Study, axis: str) -> dict[str, pl.DataFrame]:
    """Return the outcomes at each value of an axis."""
    names = {
        value: NOMINAL if each == Conditions() else f"{axis} {value}" for value, each in AXES[axis].items()
    }
    return {value: study.outcomes.filter(condition=name) for value, name in names.items()}


def _broken(study: Study, method: Method, axis: str) -> list[str]:
    """Return the values of an axis at which a method breaks."""
    found = {
        value: outcomes.filter(method=str(method)).select(SUCCESS).item()
        for value, outcomes in _along(study, axis).items()
    }
    return [value for value, success in found.items() if success < GOOD]


@styled
def figure(study: Study) -> Figure:
    """Draw success and false slips along each axis: a line for each method."""
    axes = axes_of(study.name)
    rows = -(-len(axes) // _COLUMNS)
    drawing, panels = grid(2 * rows, _COLUMNS, (WIDTH, 4.4 * rows), sharey=True)
    for panel in panels:
        panel.set_axis_off()
    for number, axis in enumerate(axes):
        found = _along(study, axis)
        top = number // _COLUMNS * 2 * _COLUMNS + number % _COLUMNS
        for panel, values, title in (
            (panels[top], SUCCESS, "success"),
            (panels[top + _COLUMNS], FALSE_FIRM, "false slips"),
        ):
            for method, color in zip(study.methods, CELLS, strict=False):
                heights = [each.filter(method=str(method)).select(values).item() for each in found.values()]
                panel.plot(list(found), heights, color=color, marker="o", markersize=3.5, label=str(method))
            panel.set_axis_on()
            panel.yaxis.grid(visible=True)
            panel.set(ylim=(-4, 104), title=f"{axis}: {title}, %")
        panels[top].axhline(GOOD, color=FAINT, linestyle="--", linewidth=0.8, zorder=0)
    drawing.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left", ncols=len(study.methods))
    return drawing

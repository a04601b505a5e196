"""The stresses as a page: goals, breaking points, and every measure along every field."""

from dataclasses import replace
from math import isnan, nan
from pathlib import Path
from typing import Final

from flows.learn.evaluation.judgement import Judgement, Truth
from flows.learn.stress import stress_figure
from flows.learn.stress.stress_fields import FALL, GOALS, GRIDS
from flows.learn.stress.stress_figure import MEASURES
from flows.learn.stress.stress_result import Stress
from flows.report.page import NONE, Page, Section, Table, drawn, number, terminal_text
from flows.report.report_files import write_page

_AGAINST: Final[dict[Truth, str]] = {
    "label": "by the arm's speed, as the paper labels",
    "sliding": "against true sliding of the contact",
}


def page(of: Stress, command: str) -> Page:
    """The findings; `command` made them."""
    text = (
        f"{len(of.names)} detectors along {len(GRIDS)} stress fields, each from nominal to broken; the line "
        f"in a panel stands at nominal. The {of.recordings} recordings of each condition are simulated with "
        f"seed {of.seed}; those of a field differ in nothing but the stress. For slip speed all strokes are "
        "translations at 50 mm/s, slowed down; else it is a small paper plan. How events are debounced is "
        "what the model's card says, or was chosen on nominal recordings of another seed."
        + "".join(f" Not there: {name}, because {why}." for name, why in of.missing.items())
    )
    figure = drawn(lambda: stress_figure.panels(of, MEASURES["balanced"]))
    sections = [
        goals(of),
        replace(breaking(of), figure=figure),
        users(of, "false_alarms_per_min"),
        users(of, "missed"),
    ]
    sections += [users(of, "onset_ms"), sliding(of), abstention(of)]
    return Page("Slip detectors under stress", text, sections, command)


def write(of: Stress, folder: Path, command: str) -> list[Path]:
    """Write ``stress.html``, ``.md``, ``.json`` and ``stress-*.svg`` into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    return write_page(page(of, command), of.json(), folder, "stress")


def text(of: Stress) -> str:
    """What a person reads in a terminal."""
    return terminal_text([goals(of), breaking(of)])


def goals(of: Stress) -> Section:
    """What is hoped for beside what was reached."""
    first = of.names[0]
    met = sum(of.at(first, goal.field, goal.value).balanced >= goal.least for goal in GOALS)
    return Section(
        "goals",
        f"{first} meets {met} of {len(GOALS)} goals under stress",
        "Balanced accuracy, %.",
        [_goals(of, "label"), _goals(of, "sliding")],
    )


def breaking(of: Stress) -> Section:
    """Where each detector breaks."""
    first = of.names[0]
    broken = sum(value is not None for field in GRIDS for value in of.breaking(first, field).values())
    sides = sum(len(grid.sides) for grid in GRIDS.values())
    return Section(
        "balanced",
        f"{first} falls by {FALL:g} points of balanced accuracy along {broken} of {sides} ways to break it",
        f"Breaking points: the value at which balanced accuracy lies {FALL:g} points below nominal, between "
        "two values interpolated; beyond the hardest value where it never does. A detector that is no better "
        "than chance has nothing to lose.",
        [_breaking(of, "label")],
    )


def users(of: Stress, key: str) -> Section:
    """False alarms, missed slips or delay."""
    first, measure = of.names[0], MEASURES[key]
    worst = [(_worst(of, first, field, key), field) for field in GRIDS]
    value, field = max(worst)
    nominal = getattr(_nominal(of, first), key)
    rows = [[GRIDS[each].text, *(number(_worst(of, name, each, key)) for name in of.names)] for each in GRIDS]
    return Section(
        key.replace("_", "-"),
        f"{measure.text}: {first} from {number(nominal)} at nominal to {number(value)} ({GRIDS[field].text})",
        "Of debounced events, by the label. The table holds the worst along each field.",
        [Table(["field", *of.names], rows)],
        drawn(lambda: stress_figure.panels(of, measure)),
    )


def sliding(of: Stress) -> Section:
    """The same against the truth."""
    first = of.names[0]
    nominal = of.at(first, *_first(), "sliding").balanced
    return Section(
        "sliding",
        f"Against true sliding {first} reaches {number(nominal)} % balanced at nominal",
        "The contact's own sliding, faster than 3 mm/s, sticks of less than 150 ms bridged: what no delay of "
        "the arm's velocity blurs. Stresses of the motion stream cannot show here, and slow slip shows only "
        "as far as it is slip by that measure.",
        [_breaking(of, "sliding")],
        drawn(lambda: stress_figure.panels(of, MEASURES["balanced"], "sliding")),
    )


def abstention(of: Stress) -> Section:
    """How much of it the pipeline itself calls degraded, or does not score."""
    first = of.names[0]
    rows = list[list[str]]()
    for field, grid in GRIDS.items():
        for side, values in grid.sides.items():
            ends = [of.outcome(field, value) for value in (values[0], values[-1])]
            shares = [ends[1].degraded, ends[0].degraded, ends[1].unscored[first]]
            rows.append([_name(field, side), grid.show(values[-1]), *map(number, shares)])
    nominal = of.outcome(*_first()).degraded
    return Section(
        "abstention",
        f"A fault is reported during {number(nominal)} % of nominal samples",
        "Health calls a fingertip degraded while a barometer is dead, stuck, saturated or drifting; overload "
        "alone saturates cells. Where more than three cells do not answer there is no score.",
        [Table(["field", "hardest", "degraded %", "at nominal %", "no score %"], rows)],
        drawn(lambda: stress_figure.abstention(of)),
    )


def _goals(of: Stress, truth: Truth) -> Table:
    rows = [
        [goal.text, f"{goal.least:g}"]
        + [number(of.at(name, goal.field, goal.value, truth).balanced) for name in of.names]
        for goal in GOALS
    ]
    nominal = ["nominal", NONE, *(number(_nominal(of, name, truth).balanced) for name in of.names)]
    return Table(["stress", "goal", *of.names], [nominal, *rows], _AGAINST[truth])


def _breaking(of: Stress, truth: Truth) -> Table:
    rows = list[list[str]]()
    for field, grid in GRIDS.items():
        points = {name: of.breaking(name, field, truth) for name in of.names}
        for side, values in grid.sides.items():
            broken = [points[name][side] for name in of.names]
            beyond = f"beyond {grid.number(values[-1])}"
            shown = [beyond if value is None else grid.number(value) for value in broken]
            rows.append([_name(field, side), *shown])
    return Table(["field", *of.names], rows, _AGAINST[truth])


def _name(field: str, side: str) -> str:
    """A field, and where it has two sides which of them."""
    grid = GRIDS[field]
    names = [grid.text, *([grid.unit] if grid.unit else []), *([side] if len(grid.sides) > 1 else [])]
    return ", ".join(names)


def _first() -> tuple[str, float]:
    field = next(iter(GRIDS))
    return field, GRIDS[field].values[0]


def _nominal(of: Stress, name: str, truth: Truth = "label") -> Judgement:
    return of.at(name, *_first(), truth)


def _worst(of: Stress, name: str, field: str, key: str) -> float:
    """The highest of a measure along a field; NaN where there is none."""
    found: list[float] = [getattr(of.at(name, field, value), key) for value in GRIDS[field].values]
    return max((each for each in found if not isnan(each)), default=nan)

"""Report of stresses: goals, breaking points, and every measure along every field."""

from math import inf, isnan, nan
from typing import Final

from flows.learn.evaluation.event_metrics import Performance
from flows.learn.evaluation.target_table import TITLES
from flows.learn.labelled_recordings import TARGETS, Target
from flows.learn.stress import stress_figure
from flows.learn.stress.stress_fields import FALL, FIELDS, GOALS, StressGoal
from flows.learn.stress.stress_figure import MEASURES
from flows.learn.stress.stress_study import Stress
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, counted, quantity

_AGAINST: Final[dict[Target, str]] = {
    "arm-speed": "by the arm's speed, as the paper labels",
    "sliding": "against true sliding of the contact",
}


def stress_report(of: Stress, command: str) -> Report:
    """Return the report of a stress study that `command` made."""
    text = (
        f"{counted(len(of.names), 'detector')} along {len(FIELDS)} stress fields, each from nominal to "
        f"broken; the line in a panel marks nominal. Each condition has "
        f"{counted(of.recordings, 'recording')}, simulated with seed {of.seed}; those of a field differ only "
        "by the stress. For slip speed all strokes are translations at 50 mm/s, slowed down; otherwise the "
        "plan is a small version of the paper's. The "
        "debounce is that of the model card, or was tuned on nominal recordings of another seed."
        + "".join(f" Missing: {name}, {why}." for name, why in of.missing.items())
    )
    debounce = {
        name: {key: getattr(each, key) for key in ("threshold", "consecutive", "release", "minimum")}
        for name, each in of.debounce.items()
    }
    facts = {
        "seed": of.seed,
        "recordings": of.recordings,
        "debounce": debounce,
        "missing": dict(of.missing),
        "fields": {field: list(grid.values) for field, grid in FIELDS.items()},
    }
    sections = [
        goals(of),
        breaking(of),
        *(events(of, key) for key in ("false_alarms_per_min", "missed", "onset_ms")),
        sliding(of),
        abstention(of),
    ]
    return Report("Slip detectors under stress", text, sections, command, facts)


def goals(of: Stress) -> Section:
    """Return the section with the goals and the values reached."""
    first = of.names[0]
    met = sum(of.at(first, goal.field, goal.value).balanced >= goal.least for goal in GOALS)
    return Section(
        "goals",
        f"{first} meets {met} of {len(GOALS)} goals under stress",
        "Against the label by the arm's speed, as in the paper, and against true sliding of the contact; the "
        "goals are balanced accuracies by the label. Delay: median onset delay. Lead: median time from an "
        "onset to the change of the arm-speed label, for onsets up to 150 ms before it.",
        [_goals(of)],
    )


def breaking(of: Stress) -> Section:
    """Return the section with the breaking points of each detector."""
    first = of.names[0]
    broken = sum(value is not None for field in FIELDS for value in of.breaking(first, field).values())
    sides = sum(len(grid.sides) for grid in FIELDS.values())
    return Section(
        "balanced",
        f"{first} loses {FALL:g} points of balanced accuracy in {broken} of {sides} directions of stress",
        f"Breaking points: the value at which balanced accuracy lies {FALL:g} points below nominal, "
        "interpolated between two values; a dash if this is not reached. A detector at chance level cannot "
        "break.",
        [_breaking(of, "arm-speed")],
        lambda: stress_figure.panels(of, MEASURES["balanced"]),
    )


def events(of: Stress, key: str) -> Section:
    """Return the section with false alarms, missed slips or delay."""
    first, measure = of.names[0], MEASURES[key]
    worst = {field: _worst(of, first, field, key) for field in FIELDS}
    field = max(worst, key=lambda each: -inf if isnan(worst[each]) else worst[each])
    nominal = getattr(_nominal(of, first), key)
    rows: list[list[Value]] = [
        [FIELDS[each].text, *(_worst(of, name, each, key) for name in of.names)] for each in FIELDS
    ]
    return Section(
        key.replace("_", "-"),
        f"{measure.text}: {first} from {quantity(nominal)} at nominal to {quantity(worst[field])} "
        f"({FIELDS[field].text})",
        "Debounced events against the label. The table gives the worst value along each field.",
        [Table(["field", *of.names], rows)],
        lambda: stress_figure.panels(of, measure),
        terminal=False,
    )


def sliding(of: Stress) -> Section:
    """Return the section with the breaking points against true sliding."""
    first = of.names[0]
    return Section(
        "sliding",
        f"Against true sliding {first} has a balanced accuracy of "
        f"{quantity(_nominal(of, first, 'sliding').balanced, '%')} at nominal",
        "Sliding of the contact faster than 3 mm/s, sticks shorter than 150 ms included. The delay of the "
        "arm's velocity and stresses of the motion stream have no effect on it. Slip slower than 3 mm/s does "
        "not count.",
        [_breaking(of, "sliding")],
        lambda: stress_figure.panels(of, MEASURES["balanced"], "sliding"),
        terminal=False,
    )


def abstention(of: Stress) -> Section:
    """Return the section with the shares of samples that are degraded or have no score."""
    first, nominal = of.names[0], of.outcome(*_first())
    heads = "degraded %", "at nominal %", "no score %"
    rows = list[list[Value]]()
    for field, grid in FIELDS.items():
        for side, values in grid.sides.items():
            first_value, hardest = (of.outcome(field, value) for value in (values[0], values[-1]))
            shares = [hardest.degraded, first_value.degraded, hardest.unscored[first]]
            rows.append([_side_name(field, side), grid.show(values[-1]), *shares])
    return Section(
        "abstention",
        f"A fault is reported during {nominal.degraded:.1f} % of nominal samples",
        "A fingertip is degraded while `Health` reports a cell as dead, stuck, saturated or drifting; "
        "overload alone saturates cells. There is no score if more than three cells have no reading.",
        [Table(["field", "hardest", *heads], rows)],
        lambda: stress_figure.abstention(of),
        terminal=False,
    )


def _goals(of: Stress) -> Table:
    rows = list[list[Value]]()
    nominal = StressGoal("nominal", *_first(), nan)
    for goal in (nominal, *GOALS):
        for target in TARGETS:
            found = [of.at(name, goal.field, goal.value, target) for name in of.names]
            wanted = goal.least if target == "arm-speed" else nan
            title = TITLES[target]
            rows.append([goal.text, f"{title}: balanced %", wanted, *(each.balanced for each in found)])
            rows.append([goal.text, f"{title}: delay ms", nan, *(each.onset_ms for each in found)])
        leads = [of.at(name, goal.field, goal.value).lead_ms for name in of.names]
        rows.append([goal.text, "lead ms", nan, *leads])
    return Table(["stress", "measure", "goal", *of.names], rows, decimals={"goal": 0})


def _breaking(of: Stress, target: Target) -> Table:
    rows = list[list[Value]]()
    for field, grid in FIELDS.items():
        points = {name: of.breaking(name, field, target) for name in of.names}
        for side, values in grid.sides.items():
            broken = [points[name][side] for name in of.names]
            shown = [None if value is None else value * grid.scale for value in broken]
            rows.append([_side_name(field, side), values[-1] * grid.scale, *shown])
    digits = dict.fromkeys(["hardest", *of.names], None)
    return Table(["field", "hardest", *of.names], rows, _AGAINST[target], digits)


def _side_name(field: str, side: str) -> str:
    """Return the name of a field, with the side if it has two."""
    grid = FIELDS[field]
    names = [grid.text, *([grid.unit] if grid.unit else []), *([side] if len(grid.sides) > 1 else [])]
    return ", ".join(names)


def _first() -> tuple[str, float]:
    field = next(iter(FIELDS))
    return field, FIELDS[field].values[0]


def _nominal(of: Stress, name: str, target: Target = "arm-speed") -> Performance:
    return of.at(name, *_first(), target)


def _worst(of: Stress, name: str, field: str, key: str) -> float:
    """Return the highest value of a measure along a field; NaN if there is none."""
    found: list[float] = [getattr(of.at(name, field, value), key) for value in FIELDS[field].values]
    return max((each for each in found if not isnan(each)), default=nan)

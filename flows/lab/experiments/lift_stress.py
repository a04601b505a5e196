"""The lift under stress: delay, sample rate, friction, mass, gripper and combinations of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import polars as pl

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.gripper_model import MQTT, GripperModel
from flows.lab.experiments.study import DEFAULT, NOMINAL, STEPS, Method, Study
from flows.lab.experiments.study_report import SUCCESS, study_facts, title
from flows.lab.experiments.trial import Conditions
from flows.report.figures import CELLS, FAINT, Axes, Figure, grid, styled
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value

METHODS: Final = (Method(DEFAULT), Method("tcn", STEPS))
DELAYS: Final = (50, 100, 125, 150, 175, 200, 225, 250, 275, 300, 350, 400, 600)  # ms, added
RATES: Final = (200.0, 50.0, 25.0, 20.0, 10.0)  # Hz; a detector trained at 100 Hz takes each sample for 10 ms
REPEATS: Final = (2, 4, 10, 20)  # samples at 100 Hz per reading
DEAD: Final = 1  # the middle cell of the lower row
GOOD: Final = 90.0  # %; a lower success counts as broken
ENOUGH: Final = 10  # trials of each object; with fewer, one failure is already below 90 %
COLOURS: Final = dict(zip(OBJECTS, CELLS, strict=True))  # by object
MARKERS: Final = dict(zip(OBJECTS, "soD^vP", strict=True))


def _gripper(**changed: Any) -> Conditions:  # noqa: ANN401 - fields of several types
    return Conditions(gripper=replace(GripperModel(), **changed))


def _hard() -> dict[str, Conditions]:
    """Return hard conditions, alone and with 100 ms of delay."""
    late = _gripper(delay=0.1)
    hard: dict[str, dict[str, Any]] = {
        "friction x0.5": {"friction": 0.5},
        "grip x0.5": {"grip": 0.5},
        "lift x2": {"pace": 2.0},
        "lift x4": {"pace": 4.0},
    }
    return {
        f"{name}{suffix}": replace(base, **changed)
        for name, changed in hard.items()
        for suffix, base in (("", Conditions()), (", +100 ms", late))
    }


# conditions by group and name
GROUPS: Final[Mapping[str, Mapping[str, Conditions]]] = {
    "delays": {NOMINAL: Conditions(), **{f"+{delay} ms": _gripper(delay=delay / 1000) for delay in DELAYS}},
    "rates": {
        **{f"{rate:g} Hz": Conditions(rate=rate) for rate in RATES},
        **{f"{Conditions().rate / each:g} Hz, repeated": Conditions(repeat=each) for each in REPEATS},
    },
    "settings": {
        **{f"friction x{factor:g}": Conditions(friction=factor) for factor in (0.75, 1.25, 1.5)},
        "mass x2": Conditions(mass=2.0),
        f"cell {DEAD} dead": Conditions(dead_cells=(DEAD,)),
        "over MQTT": _gripper(path=MQTT),
        "gripper that locks": _gripper(locks=True),
        "gripper twice as fast": _gripper(rate=2 * GripperModel().rate),
    },
    "hard": _hard(),
}
CONDITIONS: Final = {name: each for group in GROUPS.values() for name, each in group.items()}
TEXTS: Final = {
    "rates": "The detectors were trained at 100 Hz and take each sample for 10 ms. Repeated: each reading is "
    "repeated until the next one, so that the detector still gets 100 samples per second.",
    "settings": "Each condition differs from nominal in one setting.",
    "hard": "Half the friction; half the initial force; a lift at two or four times the speed.",
}


class Limit(NamedTuple):
    """Delays that an object allows, in ms; infinite: more than the longest one tried."""

    firm: float  # from the start of the lift until the grip is firm enough, median; NaN: never
    breaks: float  # added delay at which success falls below 90 %
    lost: float  # added delay at which more than 10 % of the objects fall out of the gripper


def stress_report(study: Study, command: str) -> Report:
    """Report the lift under all `CONDITIONS`, which `command` ran."""
    text = (
        f"{study.trials}, the same under each condition. Success, %, by object; lost: fell out of the "
        "gripper, %; false: slips registered before anything slid, per trial. Slide and force are medians; "
        "force is relative to the least that holds, in trials that hold."
    )
    limits = {str(method): _limits(study.of(method)) for method in study.methods}
    facts = {
        **study_facts("lift", study, study.of(study.methods[0]).filter(condition=NOMINAL)),
        "breaks_first": {name: _first_to_break(study, found) for name, found in limits.items()},
    }
    groups = [_group(study, name) for name in TEXTS]
    return Report("The lift under stress", text, [_delays(study, limits), *groups], command, facts)


def _group(study: Study, name: str) -> Section:
    """Return the section about a group of conditions."""
    tables, findings = [_table(study, method, name) for method in study.methods], list[str]()
    for method, table in zip(study.methods, tables, strict=True):
        mean = table.head.index("mean")
        good = [str(row[0]) for row in table.rows if float(row[mean] or 0) >= GOOD]
        findings.append(f"{method} holds {GOOD:.0f} % under {'; '.join(good) or 'none of them'}")
    return Section(name, ". ".join(findings), TEXTS[name], tables)


def _table(study: Study, method: Method, group: str) -> Table:
    """Return the success of a method under each condition of a group, with the costs of its lifts."""
    lifts = study.of(method).filter(pl.col("condition").is_in(list(GROUPS[group])))
    costs = lifts.group_by("condition", maintain_order=True).agg(
        SUCCESS.alias("mean"),
        (100 * pl.col("lost").mean()).alias("lost"),
        pl.col("slide").median().alias("slide mm"),
        pl.col("ratio").median().alias("force"),
        pl.col("false").mean(),
    )
    successes = [_by_condition(lifts, name, SUCCESS) for name in study.trials.objects]
    objects = [title(name) for name in study.trials.objects]
    rows: list[list[Value]] = [
        [condition, *by_object, *cells]
        for (condition, *cells), *by_object in zip(costs.iter_rows(), *successes, strict=True)
    ]
    head = ["condition", *objects, *costs.columns[1:]]
    return Table(head, rows, str(method), {"force": 2, **dict.fromkeys(objects, 0)})


def _by_condition(lifts: pl.DataFrame, name: str, values: pl.Expr) -> list[float]:
    """Return the values with an object under each condition."""
    found = lifts.filter(object=name).group_by("condition", maintain_order=True).agg(values.alias("value"))
    return found["value"].to_list()


def _delays(study: Study, limits: Mapping[str, Mapping[str, Limit]]) -> Section:
    findings = [_finding(study, method, found) for method, found in limits.items()]
    head = ["object", "firm ms", "breaks ms", "lost ms"]
    tables = [_table(study, method, "delays") for method in study.methods]
    for method, found in limits.items():
        rows: list[list[Value]] = [[title(name), *limit] for name, limit in found.items()]
        tables.append(Table(head, rows, method, dict.fromkeys(head, 0)))
    text = (
        "The delay is added between a command and the gripper. Breaks: added delay at which success falls "
        "below 90 %; lost: at which more than 10 % fall out of the gripper. Firm: median time from the start "
        "of the lift until the grip is firm enough, without added delay."
    )
    return Section(
        "lift-stress", "; ".join(findings), text, tables, lambda: figure(study, "\n".join(findings))
    )


def _limits(lifts: pl.DataFrame) -> dict[str, Limit]:
    """Return the limits with each object."""
    late = lifts.filter(pl.col("condition").is_in(list(GROUPS["delays"])))
    kept = 100 * (1 - pl.col("lost").mean())
    found = dict[str, Limit]()
    for name in lifts["object"].unique(maintain_order=True):
        firm = _by_condition(late, name, pl.col("firm").median().fill_null(math.nan))[0]
        breaks, lost = (crossing((0, *DELAYS), _by_condition(late, name, each)) for each in (SUCCESS, kept))
        found[name] = Limit(1000 * firm, breaks, lost)
    return found


def crossing(at: Sequence[float], values: Sequence[float], level: float = GOOD) -> float:
    """Return where values first fall below a level, linearly interpolated; infinite if nowhere.

    >>> crossing([0, 100, 200], [100, 95, 85])
    150.0
    """
    for k, value in enumerate(values):
        if value < level:
            if not k:
                return float(at[0])
            before = values[k - 1]
            return at[k - 1] + (at[k] - at[k - 1]) * (before - level) / (before - value)
    return math.inf


def _first_to_break(study: Study, limits: Mapping[str, Limit]) -> str | None:
    """Return the object that breaks first; None if none breaks, or there are too few objects or trials."""
    first = min(limits, key=lambda name: limits[name].breaks)
    enough = len(limits) > 1 and study.trials.count >= ENOUGH
    return first if enough and math.isfinite(limits[first].breaks) else None


def _finding(study: Study, method: str, limits: Mapping[str, Limit]) -> str:
    """Return the sentence about the object that breaks first."""
    if all(math.isinf(limit.breaks) for limit in limits.values()):
        return f"{method}: nothing breaks up to +{DELAYS[-1]} ms in {study.trials}"
    if first := _first_to_break(study, limits):
        return (
            f"{method}: the {title(first)} breaks first, at +{limits[first].breaks:.0f} ms in {study.trials}"
        )
    return f"{method}: {study.trials}, too few to find which object breaks first"


@styled
def figure(study: Study, heading: str) -> Figure:
    """Draw success and slide against added delay: a column for each method, a line for each object."""
    columns = len(study.methods)
    drawing, axes = grid(2, columns, (4.6 * columns + 0.4, 6.4), sharex=True)
    for column, method in enumerate(study.methods):
        above, below = axes[column], axes[columns + column]
        _plot(study, method, above, SUCCESS)
        _plot(study, method, below, pl.col("slide").median())
        above.axhline(GOOD, color=FAINT, linestyle="--", linewidth=0.8, zorder=0)
        above.set(ylim=(-4, 104), title=f"{method}: success, %")
        below.set(ylim=(0, 52), title="median slide, mm", xlabel="added delay, ms")
    drawing.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    drawing.suptitle(heading, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return drawing


def _plot(study: Study, method: Method, axis: Axes, values: pl.Expr) -> None:
    """Plot values against added delay, a line for each object."""
    late = study.of(method).filter(pl.col("condition").is_in(list(GROUPS["delays"])))
    for name in study.trials.objects:
        style = {"color": COLOURS[name], "marker": MARKERS[name], "markersize": 3.5}
        axis.plot((0, *DELAYS), _by_condition(late, name, values), label=title(name), **style)
    axis.yaxis.grid(visible=True)

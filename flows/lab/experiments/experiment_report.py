"""Reports of the tap and lift experiments: success, the paper's success, false slips and breaking points."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import polars as pl

from flows.lab.experiments.study import NOMINAL, Trials
from flows.lab.experiments.tap_and_lift import SIZES
from flows.lab.experiments.trial import PHASES, RANDOM
from flows.report.report_page import Report, Section
from flows.report.results import Statistic, estimate_table, estimates, median, rate, share
from flows.report.table import Table, Value

# success of 20 trials with real objects (%), "Under Pressure" (2021)
PAPER: Final[Mapping[str, Mapping[str, int]]] = {
    "ball": {"tap": 90, "lift": 35},
    "box": {"tap": 85, "lift": 100},
    "cardboard_can": {"tap": 90, "lift": 85},
    "football_sleeve": {"tap": 90, "lift": 85},
    "foam_sleeve": {"tap": 80, "lift": 35},
    "metal_can": {"tap": 90, "lift": 95},
}
TITLES: Final = {"tap": "Mallet tap", "lift": "Object lift"}
_SIDES: Final = ("method", "objects")  # the six and the random objects side by side
_REAL: Final = "paper, real objects"
GOOD: Final = ("registered", "held")  # endings of a success
SUCCESS: Final = "success %"
BY_PAPER: Final = "paper's %"
FALSE_FIRM: Final = "firm lift %"
RATES: Final = {
    SUCCESS: rate("success", "trials"),
    BY_PAPER: rate("paper", "trials"),
    FALSE_FIRM: rate("false_firm", "trials"),
}
STATISTICS: Final[Mapping[str, Statistic]] = {  # those that an experiment lacks are left out of its tables
    **RATES,
    "force": median("force"),
    "peak": median("peak"),
    "lead ms": median("lead"),
    "slide mm": median("slide"),
}
_DECIMALS: Final = {"force": 2, "peak": 2}
EVENTS: Final[Mapping[str, Statistic]] = {
    **{phase: share(f"false {phase}", "trials", 100) for phase in PHASES},
    "soft blow %": share("false_soft", "soft", 100),
    **{f"missed {size} %": share(f"missed {size}", f"blows {size}", 100) for size in SIZES},
}
_NOTES: Final = (
    "Paper's: success by the paper's definition. Firm lift: share with a false slip. Medians over trials: "
    "lead from the registered slip to the onset of sliding; slide; force of the last second and highest "
    "force, relative to the least that holds."
)
_EVENTS_NOTE: Final = (
    "False slips per 100 firm lifts in each phase; soft blows with a false slip; blows whose slip is not "
    "registered within 0.2 s, by size of the slide."
)
_TEXT: Final = (
    "Simulated trials, the same for all methods; the paper used real objects. "
    "docs/explanations/experiments.md defines success and lists the assumptions."
)


def experiment_report(experiment: str, results: pl.DataFrame, trials: Trials, command: str) -> Report:
    """Report the results of an experiment.

    Args:
        experiment: ``tap`` or ``lift``.
        results: Long table that `run_study` returned.
        trials: Trials of the study.
        command: Command line that ran it.
    """
    kind = pl.when(pl.col("fold") == RANDOM).then(pl.lit(RANDOM)).otherwise(pl.lit("six"))
    results = results.with_columns(kind.alias("objects"))
    nominal = results.filter(condition=NOMINAL)
    found = estimates(nominal, STATISTICS, by=_SIDES)
    rates = [name for name in STATISTICS if "%" in name]
    table = estimate_table(found, _DECIMALS, index=_SIDES, intervals=rates)
    if real := [PAPER[name][experiment] for name in trials.objects if name in PAPER]:
        mean = sum(real) / len(real)
        row: list[Value] = [_REAL, "six", *(mean if head == BY_PAPER else None for head in table.head[2:])]
        table = replace(table, rows=[*table.rows, row])
    events = estimate_table(estimates(nominal, EVENTS, by=_SIDES, draws=0), {}, index=_SIDES)
    sections = [
        Section(experiment, "Success and false slips", _NOTES, [table]),
        Section("events", "Events by phase", _EVENTS_NOTE, [events]),
        Section("objects", "Success by object, %", "", _objects(experiment, nominal, trials)),
        Section("failures", "Trials by ending", "", [_endings(nominal)], folded=True),
    ]
    if len(results) > len(nominal):
        sections.append(_breaking_points(results))
    return Report(TITLES[experiment], _TEXT, sections, command)


def _objects(experiment: str, nominal: pl.DataFrame, trials: Trials) -> list[Table]:
    """Return the success of each method with each object, strictly and by the paper's definition."""
    tables = list[Table]()
    for name, caption in ((SUCCESS, "Strict"), (BY_PAPER, "By the paper's definition")):
        found = estimates(nominal, {name: RATES[name]}, by=("method", "fold"), draws=0)
        decimals = dict.fromkeys(trials.objects, 0)
        tables.append(estimate_table(found, decimals, columns="fold", caption=caption))
    real = [PAPER[name][experiment] if name in PAPER else None for name in trials.objects]
    return [tables[0], replace(tables[1], rows=[*tables[1].rows, [_REAL, *real]])]


def _endings(nominal: pl.DataFrame) -> Table:
    """Return the number of trials of each method by ending, successes first."""
    endings = nominal.filter(pl.col("metric").str.starts_with("ending "))
    endings = endings.with_columns(pl.col("metric").str.strip_prefix("ending "))
    counts = endings.group_by(*_SIDES, "metric", maintain_order=True).agg(pl.col("value").sum().cast(int))
    wide = counts.pivot("metric", index=_SIDES, values="value").fill_null(0)
    head = [*_SIDES, *sorted(wide.drop(_SIDES).columns, key=lambda name: (name not in GOOD, name))]
    return Table(head, [list(row) for row in wide.select(head).rows()])


def _breaking_points(results: pl.DataFrame) -> Section:
    """Return the section about the conditions that differ from the nominal one."""
    found = estimates(results, RATES, by=("condition", "objects", "method"))
    tables = [
        estimate_table(
            found.filter(statistic=name), {}, index=("condition", "objects"), columns="method", caption=name
        )
        for name in RATES
    ]
    note = (
        "One setting differs from nominal: factors of friction, mass, stiffness and tilt; added "
        "delay of the gripper in s; sample rate in Hz."
    )
    return Section("stress", "Where each method breaks", note, tables, folded=True)

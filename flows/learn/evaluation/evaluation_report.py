"""Report of an evaluation: tables and figures that are group-bys of its results."""

from dataclasses import replace
from functools import partial
from typing import Final

import polars as pl

from flows.learn.evaluation import evaluation_figures as figures
from flows.learn.evaluation.evaluation_study import Evaluation
from flows.learn.evaluation.published import PAPER_ROWS, SURFACES, TABLE_1, TABLE_3, TABLE_3_ANY
from flows.learn.evaluation.stress_study import FIELDS, NOMINAL, condition_name, every_condition
from flows.learn.measures import (
    AGAINST_SLIDING,
    BALANCED,
    DECIMALS,
    EVENTS,
    SAMPLES,
    SHARES,
    SLIDING,
    motion_name,
)
from flows.report.report_page import Report, Section
from flows.report.results import estimate_table, estimates
from flows.report.table import Table, Value, counted
from operators import Debounce

DETECTORS_TEXT: Final = (
    "Balanced: mean of the shares of slip and of static samples that are recognised. False alarms per static "
    "minute. Delay: median from the change of the label to the event. 95 %: interval over recordings."
)
SAMPLES_TEXT: Final = (
    "Accuracy, precision and F1 as in the paper's Table I: averages over both classes, weighted by their "
    "share. Far: balanced accuracy 100 ms or more from any change of the label. Calibration error: mean "
    "distance between probability and share of slip in ten bins."
)
EVENTS_TEXT: Final = (
    "An event from 50 ms before a slip to 150 ms after it detects the slip; others are false alarms. The "
    "debounce is that of the model card, or has the least delay on the validation split within 2 false "
    "alarms per static minute and 2 % missed slips."
)
_EVENTS_MIN: Final = "events/min"
MOTIONS_TEXT: Final = "F1, %, by motion and surface, as in the paper's Table III (cylinders by axis)."
SLIDING_TEXT: Final = (
    "True sliding: the contact has moved by 0.45 mm or more in 150 ms (3 mm/s); between that and rest, "
    "samples do not count. Lead: median time from an event to the change of the arm-speed label."
)
GROUPS_TEXT: Final = "Balanced accuracy, %, on each surface or object that is held out, and on all of them."
SPEED_TEXT: Final = (
    "CPU time of a sample of one fingertip, on one core; the detectors run in turns, and the median turn "
    "counts. Front: no other detector is both faster and more accurate. The paper states no speed."
)
STRESS_TEXT: Final = (
    "Balanced accuracy, %. The recordings of all conditions differ only by the stress. For slip speed all"
    " strokes are translations at 50 mm/s, slowed down."
)
STRESS_EVENTS_TEXT: Final = (
    "Events as debounced for nominal recordings, and balanced accuracy against true sliding."
)


def evaluation_report(of: Evaluation, command: str) -> Report:
    """Return the report of an evaluation of a dataset that `command` made."""
    sections = [_detectors(of)]
    if of.results["fold"].n_unique() > 1:
        sections.append(_groups(of))
    if of.speeds:
        sections.append(_speed(of))
    sections.append(_samples(of))
    if of.results["fold"].n_unique() <= 1:  # else a method may have another debounce in each fold
        sections.append(_events(of))
    if not of.label.is_empty():
        sections.append(_sliding(of))
    sections += _motions(of)
    return Report(f"Slip detectors on {of.subject}", _notes(of), sections, command)


def stress_report(of: Evaluation, command: str) -> Report:
    """Return the report of detectors under stress that `command` made."""
    balanced = estimates(of.results, BALANCED, ("condition", "method"), draws=0)
    leader = of.results.filter(method=of.leader)
    nominal = replace(of, results=of.results.filter(condition=NOMINAL))
    chosen = {**BALANCED, **EVENTS, f"{SLIDING}balanced %": AGAINST_SLIDING[f"{SLIDING}balanced %"]}
    sections = [
        Section(
            "stress",
            "Balanced accuracy under stress",
            STRESS_TEXT,
            draw=lambda: figures.stress_panels(balanced),
        ),
        Section("stress-levels", "Every level", "", [_by_level(balanced, "method")], folded=True),
        Section(
            "stress-events",
            f"Events of {of.leader} under stress",
            STRESS_EVENTS_TEXT,
            [_by_level(estimates(leader, chosen, ("condition",), draws=0), "statistic")],
            folded=True,
        ),
    ]
    return Report("Slip detectors under stress", _notes(nominal), sections, command)


def _notes(of: Evaluation) -> str:
    """Return what a reader must know, one sentence each."""
    missing = [f"Not evaluated: {name}, {reason}" for name, reason in of.missing.items()]
    lines = [size_text(of), *of.notes, *missing]
    return " ".join(f"{line.rstrip('.')}." for line in lines)


def size_text(of: Evaluation) -> str:
    """Return how much was judged."""
    results = of.results.filter(method=of.leader)
    recordings, minutes = results["recording"].n_unique(), results.filter(metric="minutes")["value"].sum()
    return f"{counted(recordings, 'recording')}, {minutes:.1f} minutes after the warm-up"


def _detectors(of: Evaluation) -> Section:
    """Return the section that answers which detector is best."""
    statistics = {**BALANCED, **{name: each for name, each in EVENTS.items() if name != _EVENTS_MIN}}
    table = estimate_table(estimates(of.results, statistics), DECIMALS, intervals=[*statistics])
    return Section("detectors", "Detectors", DETECTORS_TEXT, [table])


def _samples(of: Evaluation) -> Section:
    """Return the section with Table I."""
    shown = {name: each for name, each in {**SHARES, **SAMPLES}.items() if name not in BALANCED}
    table = estimate_table(estimates(of.results, shown, draws=0), DECIMALS)
    if of.as_paper:
        head = [*table.head[:2], "paper's %", *table.head[2:]]
        rows = [[*row[:2], TABLE_1.get(PAPER_ROWS.get(str(row[0]), "")), *row[2:]] for row in table.rows]
        table = replace(table, head=head, rows=rows)
    return Section("samples", "Samples: Table I", SAMPLES_TEXT, [table], folded=True)


def _events(of: Evaluation) -> Section:
    """Return the section with the debounce of each method."""
    rates = estimates(of.results, {_EVENTS_MIN: EVENTS[_EVENTS_MIN]}, draws=0)
    rows: list[list[Value]] = []
    for name, rate in rates.select("method", "value").rows():
        rule = of.methods[name].debounce or Debounce()
        rows.append([name, rate, rule.threshold, rule.consecutive, rule.release, of.methods[name].chosen_on])
    head = ["method", _EVENTS_MIN, "threshold", "decisions on", "decisions off", "from"]
    return Section(
        "events", "Debounce", EVENTS_TEXT, [Table(head, rows, decimals={"threshold": 3})], folded=True
    )


def _groups(of: Evaluation) -> Section:
    results = pl.concat([of.results, of.results.with_columns(fold=pl.lit("all"))])
    table = estimate_table(estimates(results, BALANCED, ("method", "fold"), draws=0), {}, columns="fold")
    return Section("groups", "Groups held out", GROUPS_TEXT, [table])


def _speed(of: Evaluation) -> Section:
    """Return the section with the speed of each method, from fast to slow."""
    accuracy = estimates(of.results, {"accuracy %": SHARES["accuracy %"]}, draws=0)
    accuracy = accuracy.select("method", pl.col("value").alias("accuracy %"))
    speeds = pl.DataFrame({"method": [*of.speeds], "us/sample": [*of.speeds.values()]})
    points = speeds.join(accuracy, on="method", how="left").sort("us/sample")
    front = figures.pareto_front(points)
    rows = [[*row, "yes" if row[0] in front else None] for row in points.rows()]
    table = Table([*points.columns, "front"], rows, decimals=DECIMALS)
    draw = partial(figures.chart, points, front) if front else None  # nothing may be judged
    return Section("chart", "Speed against accuracy", SPEED_TEXT, [table], draw)


def _sliding(of: Evaluation) -> Section:
    statistics = {name.removeprefix(SLIDING): each for name, each in AGAINST_SLIDING.items()}
    table = estimate_table(estimates(pl.concat([of.label, of.results]), statistics, draws=0), DECIMALS)
    return Section("sliding", "True sliding", SLIDING_TEXT, [table], folded=True)


def _motions(of: Evaluation) -> list[Section]:
    """Return the section with Table III; [] if the strokes are unknown."""
    names = pl.col("condition").str.splitn(", ", 2).struct.rename_fields(["surface", "motion"])
    known = of.results.filter(pl.col("method") == of.leader, pl.col("condition") != "")
    if known.is_empty():
        return []
    parts = known.with_columns(names.struct.unnest())
    for total in (pl.lit("all").alias("surface"), pl.lit("any").alias("motion")):
        parts = pl.concat([parts, parts.with_columns(total)])
    found = estimates(parts, {"F1 %": SHARES["F1 %"]}, ("motion", "surface"), draws=0)
    ours = estimate_table(found, {}, index=["motion"], columns="surface", caption=of.leader)
    rows: list[list[Value]] = [[motion_name("", *motion)[2:], *row] for motion, row in TABLE_3.items()]
    head = ["motion", *SURFACES, "all"]
    paper = Table(head, [*rows, ["any", *TABLE_3_ANY, None]], "the paper's TCN, real recordings")
    title = "Motions and surfaces: Table III"
    return [Section("motions", title, MOTIONS_TEXT, [ours, paper], folded=True)]


def _by_level(found: pl.DataFrame, columns: str) -> Table:
    """Return a table with a row for each level of each stress field, from nominal on."""
    table = estimate_table(found, DECIMALS, index=["condition"], columns=columns)
    cells = {str(row[0]): row[1:] for row in table.rows}
    rows: list[list[Value]] = [["nominal", None, *cells[NOMINAL]]]
    for field, value in every_condition():
        if value != FIELDS[field].nominal or field == "slip_speed":
            rows.append([FIELDS[field].text, FIELDS[field].show(value), *cells[condition_name(field, value)]])
    return Table(["stress", "level", *table.head[1:]], rows, decimals=table.decimals)

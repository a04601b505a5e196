import json
from collections.abc import Sequence
from typing import Any

import polars as pl
import pytest

from flows.lab.experiments.experiment_report import experiment_report
from flows.lab.experiments.study import NOMINAL, SEED, Method, Trials, conditions_of
from flows.report.report_page import Report
from flows.report.results import Metrics, joined, result_rows

OURS, NONE = Method("psd"), Method("psd", "none")
TRIALS = Trials(2, ("ball", "box", "random"))
HELD: Metrics = {
    "trials": 1,
    "success": 1,
    "paper": 1,
    "ending held": 1,
    "false_firm": 0,
    "slide": 3,
    "lead": -20,
    "force": 1.5,
    "peak": 1.75,
}
LOST: Metrics = {
    "trials": 1,
    "success": 0,
    "paper": 0,
    "ending missed": 1,
    "false_firm": 1,
    "false load transfer": 2,
    "slide": 30,
    "peak": 0.5,
}


def lifts(names: Sequence[str] = (NOMINAL,)) -> pl.DataFrame:
    """Two trials of two objects: our rule fails once, with the ball, the other always."""
    return joined(
        result_rows(
            LOST if method == NONE or (name, seed) == ("ball", SEED) else HELD,
            method=str(method),
            recording=f"{name}-{seed}",
            condition=condition,
            fold=name,
        )
        for condition in names
        for name in TRIALS.objects
        for seed in TRIALS.seeds(name)
        for method in (OURS, NONE)
    )


def rows(report: Report, section: str, table: int = 0) -> list[dict[str, Any]]:
    """The rows of a section's table, as a program reads them."""
    found = json.loads(json.dumps(report.json(), allow_nan=False))
    return list(found["sections"][section]["tables"][table]["rows"])


@pytest.fixture
def report() -> Report:
    return experiment_report("lift", lifts(), TRIALS, "command")


def test_rates_have_intervals_and_costs_are_medians(report: Report) -> None:
    ours, none, random, _, paper = rows(report, "lift")
    assert {name: ours[name] for name in ("method", "success %", "firm lift %", "force", "lead ms")} == {
        "method": "psd, ours",
        "success %": 75,
        "firm lift %": 25,
        "force": 1.5,
        "lead ms": -20,
    }
    assert (none["success %"], none["force"]) == (0, None)
    assert [(row["objects"], row["success %"]) for row in (ours, random)] == [("six", 75), ("random", 100)]
    assert (paper["method"], paper["success %"], paper["paper's %"]) == ("paper, real objects", None, 67.5)


def test_false_slips_are_counted_by_phase(report: Report) -> None:
    ours, none, *_ = rows(report, "events")
    assert [ours["load transfer"], none["load transfer"], none["holding"]] == [50, 200, 0]


def test_success_with_each_object_stands_above_the_papers(report: Report) -> None:
    strict = [
        {"method": "psd, ours", "ball": 50, "box": 100, "random": 100},
        {"method": "psd, none", "ball": 0, "box": 0, "random": 0},
    ]
    real = {"method": "paper, real objects", "ball": 35, "box": 100, "random": None}
    assert rows(report, "objects") == strict
    assert rows(report, "objects", 1) == [*strict, real]


def test_trials_are_counted_by_ending(report: Report) -> None:
    assert rows(report, "failures") == [
        {"method": "psd, ours", "objects": "six", "held": 3, "missed": 1},
        {"method": "psd, none", "objects": "six", "held": 0, "missed": 4},
        {"method": "psd, ours", "objects": "random", "held": 12, "missed": 0},
        {"method": "psd, none", "objects": "random", "held": 0, "missed": 12},
    ]


def test_a_stress_test_has_a_row_for_each_condition() -> None:
    conditions = list(conditions_of("lift", stress=True))
    report = experiment_report("lift", lifts(conditions), TRIALS, "command")
    table = rows(report, "stress")
    assert [row["condition"] for row in table[::2]] == conditions
    assert table[2] == {"condition": conditions[1], "objects": "six", "psd, ours": 75, "psd, none": 0}

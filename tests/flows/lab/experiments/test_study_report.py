import json
from typing import Any

from flows.lab.experiments.study import Study
from flows.lab.experiments.study_report import lift_report, tap_report
from flows.report.report_page import Report


def rows(report: Report, section: str) -> list[dict[str, Any]]:
    """The rows of a section's table, as a program reads them."""
    found = json.loads(json.dumps(report.json(), allow_nan=False))
    [table] = found["sections"][section]["tables"]
    return list(table["rows"])


def test_our_success_stands_above_the_papers(lifts: Study) -> None:
    report = lift_report(lifts, "command")
    assert "psd, ours holds in 3 of 4 trials (75.0 %); the paper in 67.5 % of its own" in report.terminal()
    assert rows(report, "lift") == [
        {"success, %": "psd, ours", "ball": 50, "box": 100, "mean": 75},
        {"success, %": "psd, none", "ball": 0, "box": 0, "mean": 0},
        {"success, %": "paper, real objects", "ball": 35, "box": 100, "mean": 67.5},
    ]


def test_json_states_the_results_of_the_first_method(lifts: Study) -> None:
    found = lift_report(lifts, "command").json()
    assert (found["experiment"], found["trials"], found["seed"], found["method"]) == (
        "lift",
        2,
        7,
        "psd, ours",
    )
    assert found["mean_success"] == 75.0
    assert found["objects"] == {"ball": 50.0, "box": 100.0}
    assert found["failures"] == {"missed": 1}


def test_failures_are_counted_by_ending(taps: Study) -> None:
    report = tap_report(taps, "command")
    assert "psd, ours fails in 1 of 4 trials, mostly: too late" in report.terminal()
    assert rows(report, "failures")[0] == {"method": "psd, ours", "object": "ball", "endings": "1 too late"}
    assert [row["object"] for row in rows(report, "failures") if row["method"] == "psd, ours"] == ["ball"]


def test_costs_have_a_row_for_each_object_and_one_for_all(lifts: Study) -> None:
    found = rows(lift_report(lifts, "command"), "costs")
    assert [(row["object"], row["slide mm"], row["p90 mm"], row["force"]) for row in found[:3]] == [
        ("ball", 16.5, 27.3, 1.5),
        ("box", 3.0, 3.0, 1.5),
        ("all", 3.0, 21.9, 1.5),
    ]
    assert found[3]["force"] is None  # nothing is held


def test_false_slips_are_shares_of_trials(taps: Study) -> None:
    assert rows(tap_report(taps, "command"), "false-slips")[2] == {
        "method": "psd, ours",
        "object": "all",
        "slide mm": 2.0,
        "delay ms": 30.0,
        "blows drawn": 6,
        "lift %": 25.0,
        "soft blow %": 25.0,
        "hold, per min": 0.0,
    }

import json
from pathlib import Path
from typing import Any

from flows.lab.experiments.study import Study
from flows.lab.experiments.study_report import experiment_report, interval
from flows.report.report_page import Report
from tests.readability import ReportFaults


def rows(report: Report, section: str, table: int = 0) -> list[dict[str, Any]]:
    """The rows of a section's table, as a program reads them."""
    found = json.loads(json.dumps(report.json(), allow_nan=False))
    return list(found["sections"][section]["tables"][table]["rows"])


def test_each_rate_has_its_confidence_interval(lifts: Study, taps: Study) -> None:
    assert rows(experiment_report(lifts, ""), "lift")[0] == {
        "method": "psd, ours",
        "success %": 75,
        "95 % CI": "30-95",
        "firm lift %": 25,
        "95 % CI ": "5-70",
        "force": 1.5,
        "peak": 1.75,
        "lead ms": -20,
        "slide mm": 3,
    }
    assert rows(experiment_report(taps, ""), "tap")[1] == {
        "method": "psd, none",
        "success %": 0,
        "95 % CI": "0-49",
        "firm lift %": 100,
        "95 % CI ": "51-100",
        "soft blow %": 100,
        "95 % CI  ": "51-100",
        "lead ms": -300,
        "slide mm": 4,
    }


def test_intervals_are_those_of_wilson() -> None:
    # Newcombe, 1998, table I: 81 of 263
    assert interval(81, 263) == "26-37"
    assert interval(0, 20) == "0-16"


def test_our_success_stands_above_the_papers(lifts: Study) -> None:
    report = experiment_report(lifts, "command")
    finding = (
        "psd, ours holds, without a false slip, in 3 of 4 trials (75.0 %); the paper in 67.5 % of its own"
    )
    assert finding in report.terminal()
    assert rows(report, "objects") == [
        {"success, %": "psd, ours", "ball": 50, "box": 100, "mean": 75},
        {"success, %": "psd, none", "ball": 0, "box": 0, "mean": 0},
        {"success, %": "paper, real objects", "ball": 35, "box": 100, "mean": 67.5},
    ]
    assert rows(report, "objects", 1)[0] == {
        "object": "ball",
        "force": 1.5,
        "peak": 1.125,
        "lead ms": -20,
        "slide mm": 16.5,
    }


def test_json_states_the_results_of_the_first_method_and_of_its_rivals(lifts: Study) -> None:
    found = experiment_report(lifts, "command").json()
    assert (found["experiment"], found["trials"], found["seed"]) == ("lift", 2, 7)
    assert (found["method"], found["mean_success"], found["false_slip_firm"]) == ("psd, ours", 75.0, 25.0)
    assert found["objects"] == {"ball": 50.0, "box": 100.0}
    assert found["failures"] == {"missed": 1}
    assert found["rivals"].keys() == {"psd"}
    assert found["rivals"]["psd"].keys() == {"mean_success", "false_slip_firm"}


def test_failures_are_counted_by_ending(taps: Study) -> None:
    report = experiment_report(taps, "command")
    assert "psd, ours fails in 1 of 4 trials, mostly: too late" in report.terminal()
    assert rows(report, "failures")[0] == {"method": "psd, ours", "object": "ball", "endings": "1 too late"}
    assert [row["object"] for row in rows(report, "failures") if row["method"] == "psd, ours"] == ["ball"]


def test_the_page_is_readable_on_a_desk_and_a_phone(
    lifts: Study, tmp_path: Path, report_faults: ReportFaults
) -> None:
    assert report_faults(experiment_report(lifts, "slipflow experiment lift"), tmp_path) == []

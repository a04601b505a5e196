import json
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from flows.learn.evaluation import evaluation_figures as figures
from flows.learn.evaluation.evaluation_report import evaluation_report
from flows.learn.evaluation.evaluation_study import Evaluation, evaluate
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.measures import BALANCED, SHARES
from flows.report.report_page import Report
from flows.report.results import estimates
from flows.report.table import Value
from tests.flows.learn.evaluation.conftest import Having

COMMAND = "slipflow evaluate tiny --chart"


@pytest.fixture(scope="module")
def report(found: Evaluation) -> Report:
    noted = replace(found, notes=["a (train) is the same recording as b (test)"], missing={"oracle": "why"})
    return evaluation_report(noted, COMMAND)


def rows(report: Report, section: str, table: int = 0) -> dict[Value, dict[str, Value]]:
    """Return the rows of a table by their first cell."""
    [each] = [each for each in report.sections if each.name == section]
    chosen = each.tables[table]
    return {row[0]: dict(zip(chosen.head, row, strict=True)) for row in chosen.rows}


def test_sections_tables_and_figures_are_written(report: Report, tmp_path: Path) -> None:
    paths = report.write(tmp_path, "evaluation")
    assert [path.name for path in paths if path.suffix == ".svg"] == ["evaluation-chart.svg"]
    names = [section.name for section in report.sections]
    assert names == ["detectors", "chart", "samples", "events", "sliding", "motions"]
    assert COMMAND in paths[1].read_text()
    assert json.loads(paths[2].read_text())["sections"].keys() == {*names}
    text = paths[1].read_text().split("## ")[0]
    assert "2 recordings, 0.4 minutes after the warm-up." in text
    assert "a (train) is the same recording as b (test). Not evaluated: oracle, why." in text


def test_the_numbers_are_those_of_the_results_with_the_papers_beside_them(
    report: Report, found: Evaluation
) -> None:
    accuracy = dict(estimates(found.results, {"": SHARES["accuracy %"]}).select("method", "value").rows())
    samples = rows(evaluation_report(replace(found, as_paper=True), COMMAND), "samples")
    assert "paper's %" not in rows(report, "samples")["psd"], "of another plan"
    assert {name: row["accuracy %"] for name, row in samples.items()} == accuracy
    assert (samples["psd"]["paper's %"], samples["logistic"]["paper's %"]) == (57.4, None)
    events, rule = rows(report, "events"), found.methods["psd"].debounce
    assert rule
    assert [events["psd"][name] for name in ("threshold", "decisions on", "decisions off")] == [
        rule.threshold,
        rule.consecutive,
        rule.release,
    ]
    assert (events["tcn"]["from"], events["psd"]["from"]) == ("its card", "validation")


def test_table_3_has_a_row_for_each_motion_and_the_papers_numbers(report: Report) -> None:
    ours, paper = (rows(report, "motions", table) for table in (0, 1))
    assert ours.keys() <= paper.keys()
    assert list(ours)[-1] == list(paper)[-1] == "any"
    assert paper["primary, 5 cm/s"]["cylinder_y"] == 78.7
    assert isinstance(ours["primary, 5 cm/s"]["cylinder_y"], float)
    assert ours["any"]["all"] == rows(report, "samples")["tcn"]["F1 %"]


def test_groups_that_are_held_out_are_columns(surfaces: list[LabelledRecording], having: Having) -> None:
    found = evaluate(having(surfaces), hold_out=["all"], names=["psd"])
    report = evaluation_report(found, COMMAND)
    groups = rows(report, "groups")
    assert list(groups["psd"]) == ["method", "steel", "wood", "wool", "all"]
    assert "sliding" not in {section.name for section in report.sections}, "nobody knows it"
    [value] = estimates(found.results, BALANCED)["value"]
    assert groups["psd"]["all"] == value


def test_the_front_has_the_methods_that_no_other_beats(report: Report, found: Evaluation) -> None:
    points = pl.DataFrame(
        [("slow", 9.0, 95.0), ("fast", 1.0, 90.0), ("worse", 2.0, 90.0), ("as fast", 1.0, 80.0)],
        ["method", "us/sample", "accuracy %"],
        orient="row",
    )
    assert figures.pareto_front(points) == ["fast", "slow"]
    chart = rows(report, "chart")
    assert chart[next(iter(found.methods))]["front"] == "yes", "the most accurate"
    speeds = [row["us/sample"] for row in chart.values()]
    assert speeds == sorted(speeds, key=lambda each: each or 0)


def test_detectors_that_answer_nowhere_have_no_chart(
    surfaces: list[LabelledRecording], having: Having, tmp_path: Path
) -> None:
    brief = replace(surfaces[0].piece(slice(60, 140)), split="test")  # within the warm-up
    report = evaluation_report(evaluate(having([brief]), names=["tcn"], speed=1e-4), COMMAND)
    assert [path.name for path in report.write(tmp_path, "brief") if path.suffix == ".svg"] == []
    assert rows(report, "chart")["tcn"]["accuracy %"] is None

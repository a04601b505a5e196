import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.learn.evaluation import evaluation_page as report
from flows.learn.evaluation import evaluation_sections as sections
from flows.learn.evaluation.evaluation_study import Evaluation, evaluate
from flows.learn.evaluation.event_metrics import EventMetrics


@pytest.fixture(scope="module")
def found(tiny: Path) -> Evaluation:
    return evaluate(tiny, names=["psd", "logistic", "tcn"])


@pytest.fixture(scope="module")
def written(found: Evaluation, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    paths = report.write(found, tmp_path_factory.mktemp("out") / "new", "slipflow evaluate tiny")
    return {path.suffix: path.read_text() for path in paths}


def test_page_tables_and_numbers_are_written(written: dict[str, str], found: Evaluation) -> None:
    assert set(written) == {".html", ".md", ".json", ".svg"}
    assert json.loads(written[".json"]) == report.summary(found)
    for text in (written[".html"], written[".md"]):
        assert "slipflow evaluate tiny" in text
        assert f"{found['psd'].confusion.accuracy:.1f}" in text


def test_every_section_is_on_the_page_and_most_have_a_figure(
    written: dict[str, str], found: Evaluation
) -> None:
    names = [section.name for section in sections.sections(found)]
    assert names == ["accuracy", "confusion", "curves", "users", "motions", "changes", "sliding"]
    for name in names:
        assert f'<section id="{name}">' in written[".html"]
    assert written[".html"].count("<svg ") == 5


def test_the_page_needs_nothing_from_outside(written: dict[str, str]) -> None:
    for text in ("http:", "https:", "<script", "<link", "@import"):
        assert text not in written[".html"]


def test_titles_say_the_numbers(found: Evaluation) -> None:
    first = sections.leader(found)
    titles = {section.name: section.title for section in sections.sections(found)}
    assert f"is right on {first.confusion.accuracy:.1f} % of the samples" in titles["accuracy"]
    assert f"{first.events.false_alarms_per_min:.1f} false alarms per static minute" in titles["users"]
    assert re.search(r"in \d+ of \d+ kinds of motion", titles["motions"])
    assert re.search(r"lie within 60 ms of a change", titles["changes"])


def test_no_delay_is_told_where_no_slip_is_found(found: Evaluation) -> None:
    nothing = EventMetrics(np.empty(0), missed_slips=3, false_alarms=0, repeats=0, minutes=1.0)
    for felt, end in (
        (nothing, "and misses 100.0 % of slips"),
        (replace(nothing, missed_slips=0), "and there are no slips"),
    ):
        leader = replace(sections.leader(found), events=felt)
        [title] = [sections.users(replace(found, results=(leader,))).title]
        assert title.endswith(end)


def test_the_papers_numbers_stand_beside(found: Evaluation) -> None:
    table = sections.accuracy(found).tables[0]
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["psd"][4:8] == ["57.4", "57.9", "57.4", "57.5"]
    assert rows["logistic"][4:8] == ["-"] * 4
    head, cells = sections.cells_table(found["psd"].cells)
    assert head[1:] == ["plane", "sphere", "cylinder y", "cylinder x", "all"]
    assert cells[0][3].endswith("(78.7)")
    assert cells[6][0] == "rotation"


def test_the_summary_is_of_the_promised_shape(found: Evaluation) -> None:
    summary = report.summary(found)
    assert set(summary["methods"]) == {result.method.name for result in found.results}
    for method in summary["methods"].values():
        for key in ("accuracy", "precision", "recall", "f1", "balanced", "false_alarms_per_min", "missed"):
            assert isinstance(method[key], float)
    assert set(summary["motions"]) == set(summary["methods"])
    assert summary["motions"]["psd"]["rotation"].keys() == {"plane", "sphere", "cylinder_y", "cylinder_x"}
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary


def test_what_was_not_judged_is_named(found: Evaluation, written: dict[str, str]) -> None:
    for name, reason in found.missing.items():
        assert f"not judged: {name}, {reason}" in report.text(found)
        assert f"Not judged: {name}, {reason}." in written[".md"]


def test_a_split_that_was_fitted_to_is_called_no_test(tiny: Path) -> None:
    page = report.page(evaluate(tiny, names=["psd"], split="train"), "x")
    assert "this is no test" in page.text

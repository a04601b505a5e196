import json
import re
from dataclasses import replace

import numpy as np
import pytest

from flows.learn.evaluation import evaluation_report as sections
from flows.learn.evaluation.evaluation_report import evaluation_report
from flows.learn.evaluation.evaluation_study import Evaluation, MethodResult
from flows.learn.evaluation.event_metrics import EventMetrics
from flows.learn.evaluation.intervals import Estimate
from flows.learn.evaluation.motion_metrics import MotionConfusions
from flows.learn.evaluation.sample_metrics import EDGES, Confusion, Roc
from flows.learn.evaluation.target_table import TITLES
from flows.learn.leaks.leak import Leak
from flows.report.report_page import Report

COMMAND = "slipflow evaluate tiny"
LEAK = Leak("shared rows", "", "a (train) and b (test) share 60 rows")


def psd(found: Evaluation) -> MethodResult:
    [result] = [result for result in found.results if result.method.name == "psd"]
    return result


@pytest.fixture(scope="module")
def report(found: Evaluation) -> Report:
    return evaluation_report(found, COMMAND)


@pytest.fixture(scope="module")
def flawed(found: Evaluation) -> Report:
    """Return a report with a leak, an unchecked model and a missing method."""
    flaws = replace(found, leaks=(LEAK,), unchecked=("old",), missing={"oracle": "there is none"})
    return evaluation_report(flaws, COMMAND)


@pytest.fixture(scope="module")
def written(report: Report, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    paths = report.write(tmp_path_factory.mktemp("out") / "new", "evaluation")
    return {path.suffix: path.read_text() for path in paths}


def test_page_tables_and_numbers_are_written(written: dict[str, str], found: Evaluation) -> None:
    assert set(written) == {".html", ".md", ".json", ".svg"}
    for text in (written[".html"], written[".md"]):
        assert COMMAND in text
        assert f"{psd(found).confusion.accuracy:.1f}" in text


def test_every_section_is_on_the_page_and_most_have_a_figure(written: dict[str, str]) -> None:
    names = ["accuracy", "leaks", "intervals", "confusion", "curves", "events", "motions", "other-motions"]
    names += ["changes", "sliding"]
    assert re.findall(r'<section id="(.+?)">', written[".html"]) == names
    assert written[".html"].count("<svg ") == 5


def test_the_page_refers_to_nothing_outside(written: dict[str, str]) -> None:
    for text in ("http:", "https:", "<script", "<link", "@import"):
        assert text not in written[".html"]


def test_the_title_names_the_most_accurate_method_and_the_default(found: Evaluation) -> None:
    default = found.leader
    best = replace(psd(found), confusion=Confusion(np.eye(2)))
    for results, end in (
        ((default, psd(found)), f"tcn reaches {default.confusion.accuracy:.1f} %"),
        ((best, default), f"psd reaches 100.0 %, tcn {default.confusion.accuracy:.1f} %"),
    ):
        title = evaluation_report(replace(found, results=results), COMMAND).title
        assert title == f"Slip detectors on tiny: {end}"


def test_findings_contain_numbers(found: Evaluation) -> None:
    first = found.leader
    findings = {each.name: each.finding for each in evaluation_report(found, COMMAND).sections}
    assert f"classifies {first.confusion.accuracy:.1f} % of the samples" in findings["accuracy"]
    assert f"{first.events.false_alarms_per_min:.1f} false alarms per static minute" in findings["events"]
    assert re.search(r"in \d+ of \d+ kinds of motion", findings["motions"])
    assert re.search(r"lie within 60 ms of a change", findings["changes"])


def test_no_delay_is_given_if_no_slip_is_detected(found: Evaluation) -> None:
    name = found.leader.method.name
    nothing = EventMetrics(np.empty(0), missed_slips=3, false_alarms=0, repeats=0, minutes=1.0)
    for events, end in (
        (nothing, "per static minute, and misses 100.0 % of slips"),
        (replace(nothing, missed_slips=0), "per static minute; there are no slips"),
        (
            replace(nothing, minutes=0.0),
            f"{name} misses 100.0 % of slips; nothing is static",
        ),
    ):
        leader = replace(found.leader, events=events)
        assert sections.events(replace(found, results=(leader,))).finding.endswith(end)


def test_tables_contain_the_papers_numbers(found: Evaluation) -> None:
    rows = {row[0]: list(row[1:]) for row in sections.accuracy(found).tables[0].rows}
    assert rows["psd"][4:8] == [57.4, 57.9, 57.4, 57.5]
    assert all(np.isnan(float(str(value))) for value in rows["logistic"][4:8])
    ours, paper = sections.motions(found)[0].tables
    assert ours.head == paper.head == ["motion", "plane", "sphere", "cylinder y", "cylinder x", "all"]
    assert [row[0] for row in ours.rows] == [row[0] for row in paper.rows]
    assert paper.rows[0][3] == 78.7


def test_the_numbers_of_every_method_are_in_the_json(written: dict[str, str], found: Evaluation) -> None:
    data = json.loads(written[".json"])
    assert (data["dataset"], data["split"], data["samples"]) == ("tiny", "test", found.samples)
    tables = {name: section["tables"] for name, section in data["sections"].items()}
    for result in found.results:
        [row] = [row for row in tables["accuracy"][0]["rows"] if row["method"] == result.method.name]
        assert row["accuracy"] == pytest.approx(result.confusion.accuracy, rel=1e-5)
        assert row["recall"] == row["accuracy"]
        [row] = [row for row in tables["events"][0]["rows"] if row["method"] == result.method.name]
        assert row["false/min"] == pytest.approx(result.events.false_alarms_per_min, rel=1e-5)
        assert row["threshold"] == result.debounce.threshold


def test_both_targets_and_the_lead_are_in_one_table(written: dict[str, str], found: Evaluation) -> None:
    [table] = json.loads(written[".json"])["sections"]["sliding"]["tables"]
    rows = {row["method"]: row for row in table["rows"]}
    assert rows.keys() == {"the arm-speed label", *(result.method.name for result in found.results)}
    row, result = rows["psd"], psd(found)
    for target, name in TITLES.items():
        expected = result.performance[target]
        assert row[f"{name}: balanced %"] == pytest.approx(expected.balanced, rel=1e-5)
        assert row[f"{name}: delay ms"] == pytest.approx(expected.onset_ms, rel=1e-5)
    assert row["lead ms"] == pytest.approx(result.performance["sliding"].lead_ms, rel=1e-5)
    assert row["trained on"] == "arm-speed"
    unknown = replace(found, label={"arm-speed": found.label["arm-speed"]})
    assert sections.sliding(unknown) == []


def test_missing_methods_are_named_with_the_reason(flawed: Report) -> None:
    assert "Not evaluated: oracle, there is none." in flawed.markdown("evaluation")
    assert flawed.json()["missing"] == {"oracle": "there is none"}


def test_leaks_are_named_on_the_page_and_in_the_json(flawed: Report) -> None:
    for text in (flawed.html(), flawed.markdown("evaluation"), flawed.terminal()):
        assert LEAK.finding in text
    assert LEAK.finding in flawed.text
    assert flawed.json()["leaks"] == [LEAK.json()]
    assert "The cards of old do not list" in flawed.markdown("evaluation")


def test_intervals_contain_the_figure(found: Evaluation) -> None:
    leader = replace(found.leader, figures=replace(found.leader.figures, balanced=Estimate(90.0, 88.0, 91.0)))
    section = sections.intervals(replace(found, results=(leader,)))
    assert section.finding.endswith("is 90.0 %, 88.0 to 91.0 over recordings")
    [row] = section.tables[0].rows
    assert row[1:3] == [90.0, "88.0 to 91.0"]


def test_single_things_and_missing_values_are_worded_well(found: Evaluation) -> None:
    nothing = np.zeros(len(EDGES), np.intp)
    truth = np.zeros(2, np.bool_)
    motions = found.leader.motions
    strokes = [place for place, kind in enumerate(motions.kinds) if kind.kind != "rotation"]
    kinds = tuple(motions.kinds[place] for place in strokes)
    leader = replace(
        found.leader,
        confusion=Confusion(np.array([[9.0, 1.0], [0.0, 0.0]])),
        events=EventMetrics(np.empty(0), missed_slips=0, false_alarms=0, repeats=0, minutes=1.0),
        roc=Roc.of(np.zeros(2), truth),
        changes=replace(found.leader.changes, samples=nothing, errors=nothing),
        motions=MotionConfusions(kinds, motions.recordings[strokes], motions.counts[strokes]),
        figures=replace(found.leader.figures, balanced=Estimate(np.nan)),
    )
    static = replace(found, results=(leader,), recordings=1, samples=1)
    report = evaluation_report(static, COMMAND)
    for text in (report.markdown("evaluation"), report.terminal()):
        assert "nan" not in text.replace("-", " ").split()
    assert report.text.startswith("1 method on the test split of tiny: 1 recording, ")
    findings = {each.name: each.finding for each in report.sections}
    assert findings["confusion"].endswith("recognises 90.0 % of static")
    assert findings["curves"].startswith(f"The area under the ROC of {leader.method.name} is unknown; ")
    assert "rotation" not in findings["motions"]


def test_labels_by_hand_are_not_called_labels_by_arm_speed(found: Evaluation) -> None:
    corrected = replace(found, by_hand="labels by hand: 5 of 9 samples of one version 1")
    [section] = sections.sliding(corrected)
    assert section.finding.startswith("Against true sliding the label by arm speed and hand has a balanced")
    assert section.tables[0].rows[0][0] == "the label by arm speed and hand"
    assert section.tables[0].head[2] == "arm and hand: balanced %"
    for part in evaluation_report(corrected, COMMAND).sections:
        assert "arm-speed label" not in part.text + part.finding

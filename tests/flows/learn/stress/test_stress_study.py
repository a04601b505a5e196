from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from connectors.sim.paper_plan import PaperPlan
from flows.learn.evaluation.event_metrics import performances
from flows.learn.evaluation.target_table import TITLES
from flows.learn.labelled_recordings import LabelledRecording, simulated_recordings
from flows.learn.scoring import probabilities
from flows.learn.stress import stress_figure
from flows.learn.stress.stress_fields import FIELDS, GOALS, stressed
from flows.learn.stress.stress_report import stress_report
from flows.learn.stress.stress_study import Stress, run_stress, stress
from flows.report.report_page import Report
from operators import Debounce
from operators.batch import Counts, Reals
from operators.detectors import Detector, Psd
from operators.errors import ParameterError

TINY = PaperPlan(surfaces=("plane",), speeds=(0.05,), repeats=1, rotations=0, rounds=1)
SEED = 7


@dataclass(frozen=True)
class Always:
    """Detector that always predicts slip."""

    length: int = 10
    name = "always"

    def score(self, windows: Counts | Reals) -> Reals:
        return np.ones(len(windows))


@pytest.fixture(scope="module")
def found() -> Stress:
    subjects: dict[str, tuple[Detector, Debounce]] = {
        "psd": (Psd(), Debounce()),
        "always": (Always(), Debounce()),
    }
    return run_stress(subjects, {"oracle": "there is none"}, SEED, TINY, jobs=1)


def test_every_value_of_every_field_is_evaluated(found: Stress) -> None:
    values = {(field, value) for field, grid in FIELDS.items() for value in grid.values}
    assert found.outcomes.keys() == values
    assert (found.names, found.recordings) == (("psd", "always"), 1)


def test_a_detector_that_always_predicts_slip_has_50_percent_and_breaks_nowhere(found: Stress) -> None:
    for field, grid in FIELDS.items():
        for value in grid.values:
            if (field, value) != ("dead", 4):
                assert found.at("always", field, value).balanced == 50
        if field != "dead":
            assert set(found.breaking("always", field).values()) == {None}


def test_with_more_than_three_dead_cells_there_is_no_score(found: Stress) -> None:
    for dead in range(5):
        outcome = found.outcome("dead", dead)
        assert outcome.unscored == {"psd": 100 * (dead > 3), "always": 100 * (dead > 3)}
        assert np.isnan(outcome.performance["psd", "arm-speed"].balanced) == (dead > 3)
    assert found.outcome("dead", 4).performance["always", "arm-speed"].missed == 100
    assert found.breaking("always", "dead") == {"up": 4}


def test_health_reports_dead_stuck_and_floored_cells_but_not_noise(found: Stress) -> None:
    nominal = found.outcome("noise", 0.6).degraded
    assert nominal < 50
    assert found.outcome("dead", 1).degraded == 100
    assert found.outcome("floored", 1).degraded == 100
    assert found.outcome("stuck", 1).degraded > 85
    assert found.outcome("noise", 28).degraded == pytest.approx(nominal, abs=10)


def test_nominal_is_the_same_recordings_in_every_field_but_slip_speed(found: Stress) -> None:
    nominal = {field: found.outcome(field, grid.values[0]) for field, grid in FIELDS.items()}
    del nominal["slip_speed"]
    assert len({id(outcome) for outcome in nominal.values()}) == 1


def test_a_stress_of_the_motion_stream_moves_the_label_and_not_the_truth(found: Stress) -> None:
    nominal, off = (found.outcome("motion_clock_offset", value).performance for value in (0, 0.1))
    before, after = nominal["psd", "sliding"], off["psd", "sliding"]
    assert replace(before, lead_ms=0) == replace(after, lead_ms=0)
    assert after.lead_ms - before.lead_ms == pytest.approx(100, abs=30)  # the label is later by as much
    assert nominal["psd", "arm-speed"] != off["psd", "arm-speed"]


def test_the_numbers_are_those_of_the_stressed_recordings(found: Stress) -> None:
    recordings = simulated_recordings(TINY, SEED, lambda scene: stressed(scene, "friction", 0.3))
    answers = [probabilities(Psd(), recording) for recording in recordings]
    expected = performances(recordings, answers, Debounce())["arm-speed"]
    assert repr(found.at("psd", "friction", 0.3)) == repr(expected)  # NaN differs from itself


def test_two_processes_find_what_one_finds(found: Stress, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"dead": replace(FIELDS["dead"], values=(0, 1))}
    monkeypatch.setattr("flows.learn.stress.stress_study.FIELDS", few)
    subjects = {"psd": (Psd(), Debounce())}
    done = list[tuple[int, int]]()

    def progress(number: int, of: int) -> None:
        done.append((number, of))

    again = run_stress(subjects, {}, SEED, TINY, jobs=2, progress=progress)
    assert done == [(number, 2) for number in range(3)]
    for value in few["dead"].values:
        assert repr(again.at("psd", "dead", value)) == repr(found.at("psd", "dead", value))


def test_methods_are_fitted_and_tuned_on_other_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "flows.learn.stress.stress_study.FIELDS", {"noise": FIELDS["noise"], "dead": FIELDS["dead"]}
    )
    seeds, log = list[int](), list[str]()

    def noted(plan: PaperPlan, seed: int, *_: object) -> list[LabelledRecording]:
        seeds.append(seed)
        return simulated_recordings(plan, seed)

    monkeypatch.setattr("flows.learn.stress.stress_study.simulated_recordings", noted)
    found = stress(names=["psd"], seed=SEED, plan=TINY, training=TINY, jobs=1, log=log.append)
    assert found.names == ("psd",)
    assert SEED in seeds[2:]
    assert SEED not in seeds[:2]
    assert seeds[0] != seeds[1]
    assert log == ["fitting psd", "tuning psd"]


@pytest.fixture(scope="module")
def report(found: Stress) -> Report:
    """Return a report that draws its figures once, which takes long."""
    return stress_report(found, "slipflow stress")


def test_the_report_has_every_section_and_every_figure(report: Report, tmp_path: Path) -> None:
    paths = report.write(tmp_path, "stress")
    assert [path.suffix for path in paths] == [".html", ".md", ".json", *[".svg"] * 6]
    markdown, page = paths[1].read_text(), paths[0].read_text()
    assert markdown.count("\n## ") == page.count("<section") == 7
    assert page.count("<svg ") == 6
    assert "| slip at 4 mm/s" in markdown
    assert "Missing: oracle, there is none." in markdown
    for path in paths[3:]:
        root = ET.parse(path).getroot()  # noqa: S314 - ours
        drawn = {"".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")}
        assert {"noise, counts", "gain", "slip speed, mm/s"} <= drawn


def test_goals_and_breaking_points_are_in_the_json(found: Stress) -> None:
    data = stress_report(found, "slipflow stress").json()
    assert data["missing"] == {"oracle": "there is none"}
    assert data["fields"].keys() == FIELDS.keys()
    [table] = data["sections"]["goals"]["tables"]
    goals = {(row["stress"], row["measure"]): row for row in table["rows"]}
    measures = [
        *(f"{name}: {what}" for name in TITLES.values() for what in ("balanced %", "delay ms")),
        "lead ms",
    ]
    assert list(goals) == list(product(["nominal", *(goal.text for goal in GOALS)], measures))
    assert {goals["nominal", f"{name}: balanced %"]["always"] for name in TITLES.values()} == {50}
    wanted = {text: row["goal"] for (text, measure), row in goals.items() if measure == measures[0]}
    assert wanted == {"nominal": None, **{goal.text: goal.least for goal in GOALS}}
    breaking = {row["field"]: row for row in data["sections"]["balanced"]["tables"][0]["rows"]}
    assert (breaking["dead cells"]["hardest"], breaking["dead cells"]["always"]) == (4, 4)
    assert breaking["noise, counts"]["always"] is None


def test_each_field_has_a_panel(found: Stress) -> None:
    figure = stress_figure.panels(found, stress_figure.MEASURES["missed"])
    titles = [axis.get_title("left") for axis in figure.axes]
    assert [title.partition(",")[0] for title in titles if title] == [grid.text for grid in FIELDS.values()]


def test_a_terminal_shows_goals_and_breaking_points(found: Stress) -> None:
    text = stress_report(found, "slipflow stress").terminal()
    assert "psd meets" in text
    assert "| slip speed, mm/s " in text


def test_a_negative_seed_or_zero_jobs_are_refused() -> None:
    with pytest.raises(ParameterError, match="seed"):
        stress(seed=-1)
    with pytest.raises(ParameterError, match="jobs"):
        stress(jobs=0)

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from flows.lab.experiments.gripper_model import MQTT, GripperModel
from flows.lab.experiments.lift_stress import CONDITIONS, DELAYS, GROUPS, crossing, stress_report
from flows.lab.experiments.lift_trial import LiftOutcome, lift
from flows.lab.experiments.study import Method, Study
from flows.lab.experiments.trial import Conditions
from tests.flows.lab.experiments.conftest import MakeStudy

HELD = LiftOutcome("held", 3.0, 20.0, 1.5, 1.75, 0, 0.15, lost=False)
LOST = LiftOutcome("too late", 30.0, 20.0, math.nan, 0.5, 1, math.nan, lost=True)
NONE = Method("psd", "none")


def _study(make_study: MakeStudy, limits: dict[str, int], trials: int = 10) -> Study:
    """A study in which each object is lost from an added delay (ms) on, and under all hard conditions."""

    def outcome(name: str, condition: str) -> LiftOutcome:
        late = 1000 * CONDITIONS[condition].gripper.delay >= limits[name]
        return LOST if late or condition in GROUPS["hard"] else HELD

    return make_study(
        lift, {(each, NONE, name): [outcome(name, each)] * trials for each in CONDITIONS for name in limits}
    )


def _rows(study: Study, section: str, table: int = 0) -> list[dict[str, Any]]:
    found = json.loads(json.dumps(stress_report(study, "").json(), allow_nan=False))
    return list(found["sections"][section]["tables"][table]["rows"])


def test_each_single_condition_differs_from_nominal_in_one_setting() -> None:
    nominal = Conditions()
    for group in ("delays", "rates", "settings"):
        for name, each in GROUPS[group].items():
            changed = [f.name for f in fields(each) if getattr(each, f.name) != getattr(nominal, f.name)]
            assert len(changed) == (name != "nominal")
    assert len(set(map(repr, CONDITIONS.values()))) == len(CONDITIONS) == sum(map(len, GROUPS.values()))


def test_conditions_are_as_named() -> None:
    assert CONDITIONS["+50 ms"] == Conditions(gripper=GripperModel(delay=0.05))
    assert CONDITIONS["over MQTT"] == Conditions(gripper=GripperModel(path=MQTT))
    assert CONDITIONS["gripper that locks"].gripper.locks
    assert CONDITIONS["50 Hz"] == Conditions(rate=50.0)
    assert CONDITIONS["50 Hz, repeated"] == Conditions(repeat=2)
    assert CONDITIONS["mass x2"] == Conditions(mass=2.0)
    assert CONDITIONS["cell 1 dead"].dead_cells == (1,)
    assert CONDITIONS["lift x2, +100 ms"] == Conditions(gripper=GripperModel(delay=0.1), pace=2.0)


def test_success_crosses_a_level_between_two_delays() -> None:
    assert crossing([0, 100, 200], [100, 95, 85]) == 150
    assert crossing([0, 100], [80, 100]) == 0
    assert crossing([0, 100], [100, 90]) == math.inf


def test_the_report_has_a_row_for_each_condition(make_study: MakeStudy) -> None:
    study = _study(make_study, {"ball": 200, "box": 100})
    sections = {"lift-stress": "delays", "rates": "rates", "settings": "settings", "hard": "hard"}
    for section, group in sections.items():
        assert [row["condition"] for row in _rows(study, section)] == list(GROUPS[group])
    late = next(row for row in _rows(study, "lift-stress") if row["condition"] == "+150 ms")
    assert late == {
        "condition": "+150 ms",
        "ball": 100,
        "box": 0,
        "mean": 50,
        "lost": 50,
        "slide mm": 16.5,
        "force": 1.5,
        "false": 0.5,
    }
    assert _rows(study, "hard")[0]["force"] is None  # nothing is held
    text = stress_report(study, "").terminal()
    assert "psd, none holds 90 % under none of them" in text
    assert "psd, none holds 90 % under 200 Hz; 50 Hz" in text


def test_the_report_names_the_object_that_breaks_first(make_study: MakeStudy) -> None:
    study = _study(make_study, {"ball": 200, "box": 100})
    report = stress_report(study, "")
    assert "psd, none: the box breaks first, at +55 ms in 10 trials of each object" in report.terminal()
    assert report.json()["breaks_first"] == {"psd, none": "box"}
    assert _rows(study, "lift-stress", 1) == [
        {"object": "ball", "firm ms": 150, "breaks ms": 177.5, "lost ms": 177.5},
        {"object": "box", "firm ms": 150, "breaks ms": 55, "lost ms": 55},
    ]


@pytest.mark.parametrize(
    ("limits", "trials", "finding"),
    [
        ({"ball": 100}, 10, "10 trials of each object, too few to find which object breaks first"),
        ({"ball": 200, "box": 100}, 9, "9 trials of each object, too few to find which object breaks first"),
        ({"ball": 1000, "box": 1000}, 10, f"nothing breaks up to +{DELAYS[-1]} ms"),
    ],
)
def test_one_object_or_few_trials_are_not_ranked(
    make_study: MakeStudy, limits: dict[str, int], trials: int, finding: str
) -> None:
    report = stress_report(_study(make_study, limits, trials), "")
    assert f"psd, none: {finding}" in report.terminal()
    assert report.json()["breaks_first"] == {"psd, none": None}


def test_a_report_is_written_with_its_figure(make_study: MakeStudy, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    report = stress_report(_study(make_study, {"ball": 200}), "slipflow experiment")
    paths = report.write(tmp_path, "lift-stress")
    assert [path.name for path in paths] == [f"lift-stress.{end}" for end in ("html", "md", "json", "svg")]
    assert "added delay, ms" in (tmp_path / "lift-stress.svg").read_text()

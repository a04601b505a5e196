import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from flows.lab.experiments.break_report import AXES, axes_of, break_report, conditions_of
from flows.lab.experiments.lift_trial import LiftOutcome, lift
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.study import Study
from flows.lab.experiments.trial import Conditions
from flows.report import figures
from tests.flows.lab.experiments.conftest import MakeStudy
from tests.readability import ReportFaults

HELD = LiftOutcome("held", False, 3.0, -20.0, 1.5, 1.75)  # noqa: FBT003
LOST = LiftOutcome("false slip", True, 30.0, -20.0, 1.5, 0.5)  # noqa: FBT003
PSD, NONE = Method("psd", "steps"), Method("psd", "none")


@pytest.fixture
def study(make_study: MakeStudy) -> Study:
    """A study in which one method breaks at half the friction and the other always."""
    return make_study(
        lift,
        {
            (name, method, "ball"): [LOST if method == NONE or name == "friction x0.5" else HELD] * 2
            for name in conditions_of("lift")
            for method in (PSD, NONE)
        },
    )


def test_each_condition_differs_from_nominal_in_one_setting() -> None:
    for values in AXES.values():
        changed = [
            [each.name for each in fields(one) if getattr(one, each.name) != getattr(Conditions(), each.name)]
            for one in values.values()
        ]
        assert sorted(map(len, changed)) == [0, *[1] * (len(values) - 1)]  # one is nominal
        assert len({name for names in changed for name in names}) == 1
    assert Conditions(tilt=2.0) in AXES["pad"].values()


def test_only_a_lift_has_a_latency() -> None:
    assert set(axes_of("lift")) - set(axes_of("tap")) == {"latency"}
    assert len(conditions_of("lift")) == 1 + sum(len(values) - 1 for values in AXES.values())


def test_a_method_breaks_where_its_success_is_low(study: Study) -> None:
    found: dict[str, Any] = json.loads(json.dumps(break_report(study, "").json(), allow_nan=False))
    assert found["breaks"]["psd, steps"] == {name: ["x0.5"] if name == "friction" else [] for name in AXES}
    assert found["breaks"]["psd, none"]["pad"] == list(AXES["pad"])
    assert (found["mean_success"], found["false_slip_firm"]) == (100, 0)
    section = found["sections"]["friction"]
    assert section["finding"].startswith(
        "Friction: psd, steps breaks at x0.5; psd, none breaks at x0.5, x0.75"
    )
    assert section["tables"][0]["rows"][0] == {
        "friction": "x0.5",
        "method": "psd, steps",
        "success %": 0,
        "95 % CI": "0-66",
        "false %": 100,
    }


def test_the_figure_has_a_line_for_each_method_on_each_axis(study: Study) -> None:
    if figures.missing_matplotlib():
        pytest.skip("matplotlib is not installed")
    [first, *others] = break_report(study, "").sections
    assert first.svg.count("friction: success, %") == 1
    assert not any(section.draw for section in others)


def test_the_page_is_readable_on_a_desk_and_a_phone(
    study: Study, tmp_path: Path, report_faults: ReportFaults
) -> None:
    assert report_faults(break_report(study, "slipflow experiment lift --stress"), tmp_path) == []

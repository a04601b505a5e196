from dataclasses import fields

from flows.lab.experiments.lift_stress import NOMINAL, stress, stress_conditions
from flows.lab.experiments.study import Method, Trials
from flows.lab.experiments.trial import Conditions


def test_each_condition_differs_from_nominal_in_one_thing() -> None:
    nominal = Conditions()
    tried = stress_conditions(nominal)
    for name, each in tried.items():
        changed = [f.name for f in fields(each) if getattr(each, f.name) != getattr(nominal, f.name)]
        assert len(changed) == (name != NOMINAL)
    assert len(set(map(repr, tried.values()))) == len(tried)


def test_conditions_are_as_named() -> None:
    tried = stress_conditions(Conditions())
    assert tried["delay +50 ms"].gripper.delay == 0.05
    assert tried["friction x0.5"].friction == 0.5
    assert tried["mass x2"].mass == 2.0
    assert tried["50 Hz"].rate == 50.0
    assert tried["cell 1 dead"].dead_cells == (1,)


def test_the_report_has_a_row_for_each_condition() -> None:
    seen: list[tuple[int, int, str]] = []
    trials, method = Trials(1, objects=("ball",)), Method("psd", "none")
    report = stress(
        method,
        Conditions(),
        trials,
        "command",
        jobs=1,
        progress=lambda done, total, label: seen.append((done, total, label)),
    )
    names = list(stress_conditions(Conditions()))
    [table] = report.json()["sections"]["lift-stress"]["tables"]
    assert [row["condition"] for row in table["rows"]] == names
    assert seen[-1] == (len(names), len(names), names[-1])
    assert report.json()["mean_success"] == 0

from typing import Any

import pytest

from flows.lab.experiments.lift_trial import lift
from flows.lab.experiments.study import RULES, Method, Trials, run_study
from flows.lab.experiments.tap_trial import tap
from flows.lab.experiments.trial import Conditions
from operators import Grip, InputError, ParameterError, StepGrip
from storage import load_debounce

NONE, STEPS = Method("psd", "none"), Method("psd", "steps")
NOMINAL = {"": Conditions()}


def test_each_method_gets_the_same_trials_and_processes_change_nothing() -> None:
    seen: list[tuple[int, int, str]] = []
    trials = Trials(3, objects=("ball",))
    alone, shared = (
        run_study(
            lift,
            [NONE, STEPS],
            NOMINAL,
            trials,
            jobs=jobs,
            progress=lambda done, total, label: seen.append((done, total, label)),
        )
        for jobs in (1, 2)
    )
    assert repr(alone) == repr(shared)
    assert seen[0] == (0, 6, "")
    assert seen[-1] == (6, 6, "psd, steps: ball")


def test_the_trial_of_a_seed_does_not_depend_on_the_number_of_trials() -> None:
    few, more = (
        run_study(lift, [NONE], NOMINAL, Trials(n, 50, ("box",)), jobs=1)[""].of(NONE) for n in (1, 2)
    )
    assert repr(few[0]) == repr(more[0])
    assert repr(more[0]) != repr(more[1])


def test_without_control_no_object_is_held() -> None:
    results = run_study(lift, [NONE], NOMINAL, Trials(2, objects=("box", "ball")), jobs=1)[""]
    assert results.mean(NONE) == results.success(NONE, "box") == 0
    assert all(outcome.peak < 1 for outcome in results.of(NONE))


def test_a_rule_takes_the_threshold_of_the_model_card() -> None:
    card = load_debounce("tcn")
    assert card
    rules = {rule: Method("tcn", rule).controller() for rule in RULES}
    assert {rule.threshold for rule in rules.values()} == {card.threshold}
    assert isinstance(rules["steps"], StepGrip)
    none = rules["none"]
    assert isinstance(none, Grip)
    assert none.gain == 0


@pytest.mark.parametrize("values", [{"methods": []}, {"conditions": {}}, {"jobs": 0}])
def test_an_empty_study_is_refused(values: dict[str, Any]) -> None:
    given: dict[str, Any] = {"methods": [NONE], "conditions": NOMINAL, "trials": Trials(1), **values}
    with pytest.raises(ParameterError, match=r"experiment: .* must be at least 1"):
        run_study(tap, **given)


def test_an_unknown_object_rule_or_detector_is_named() -> None:
    with pytest.raises(ParameterError, match="object is 'nope', must be one of box, ball"):
        Trials(1, objects=("nope",))
    with pytest.raises(ParameterError, match="count is 0, must be at least 1"):
        Trials(0)
    with pytest.raises(ParameterError, match="rule is 'best', must be one of ours, steps, none"):
        Method("tcn", "best")
    with pytest.raises(InputError, match="is not a detector"):
        run_study(lift, [Method("tcm")], NOMINAL, Trials(1), jobs=1)

import numpy as np

from flows.lab.experiments.study import DEFAULT, METHODS, RIVALS, RULES, Method, StepThreshold
from operators import Grip, StepGrip
from storage import load_debounce
from storage.models import load_card, shipped_path


def test_a_step_above_the_threshold_within_30_ms_is_slip() -> None:
    window = np.zeros((3, 4, 6), np.int16)
    window[1, 3, 2], window[2, 3, 5], window[2, 1, 5] = -8, 9, 40
    assert StepThreshold().score(window).round(2).tolist() == [0, 0.5, 0.53]


def test_each_usual_method_has_a_threshold_tuned_on_validation_trials() -> None:
    assert [method.detector for method in METHODS] == [DEFAULT, *RIVALS]
    for method in METHODS:
        card = load_card(shipped_path(f"{method.detector.removesuffix('_grasp')}_grasp"))
        _, controller = method.load()
        assert controller.threshold == card["debounce"]["threshold"]
        assert controller.threshold == card["tuning"]["threshold"]
        assert card["tuning"]["taps"] >= 50


def test_a_rule_takes_the_threshold_of_the_model_card() -> None:
    card = load_debounce("tcn")
    assert card
    rules = {rule: Method("tcn", rule).load()[1] for rule in RULES}
    assert {rule.threshold for rule in rules.values()} == {card.threshold}
    assert isinstance(rules["steps"], StepGrip)
    none = rules["none"]
    assert isinstance(none, Grip)
    assert none.gain == 0

import numpy as np

from flows.lab.experiments.study import DEFAULT, METHODS, RIVALS, RULES, THRESHOLDS, Method, StepThreshold
from operators import Grip, StepGrip
from storage import load_debounce


def test_a_step_above_the_threshold_within_30_ms_is_slip() -> None:
    window = np.zeros((3, 4, 6), np.int16)
    window[1, 3, 2], window[2, 3, 5], window[2, 1, 5] = -8, 9, 40
    assert StepThreshold().score(window).round(2).tolist() == [0, 0.5, 0.53]


def test_the_rivals_have_thresholds_of_their_own_and_the_papers_rule() -> None:
    assert [method.detector for method in METHODS] == [DEFAULT, *RIVALS]
    for method in METHODS[1:]:
        detector, controller = method.load()
        assert (detector.name, type(controller)) == (method.detector, StepGrip)
        assert controller.threshold == THRESHOLDS[method.detector]


def test_a_rule_takes_the_threshold_of_the_model_card() -> None:
    card = load_debounce("frequency_cnn")
    rules = {rule: Method("frequency_cnn", rule).load()[1] for rule in RULES}
    assert {rule.threshold for rule in rules.values()} == {card.threshold}
    assert isinstance(rules["steps"], StepGrip)
    none = rules["none"]
    assert isinstance(none, Grip)
    assert none.gain == 0

import pytest

from flows.lab.experiments.experiment import RULES, Method, experiment
from flows.lab.experiments.lifting import Lifting
from flows.lab.experiments.trial_setting import Conditions
from operators import Grip, InputError, ParameterError, StepGrip
from storage import load_debounce

NONE, STEPS = Method("psd", "none"), Method("psd", "steps")


def test_each_method_gets_the_same_trials_and_processes_change_nothing() -> None:
    seen: list[tuple[int, int, str]] = []
    alone = experiment(
        "lift",
        [NONE, STEPS],
        trials=3,
        objects=["ball"],
        jobs=1,
        progress=lambda done, of, part: seen.append((done, of, part)),
    )
    shared = experiment("lift", [NONE, STEPS], trials=3, objects=["ball"], jobs=2)
    assert repr(alone.outcomes) == repr(shared.outcomes)
    assert seen[0][:2] == (0, 6)
    assert seen[-1] == (6, 6, "psd, steps: ball")


def test_the_trials_of_a_seed_do_not_depend_on_how_many_there_are() -> None:
    few, more = (
        experiment("lift", [NONE], trials=n, seed=50, objects=["box"], jobs=1).outcomes[NONE.name, "box"]
        for n in (1, 2)
    )
    assert repr(few[0]) == repr(more[0])
    assert repr(more[0]) != repr(more[1])


def test_without_control_nothing_that_is_gripped_too_weakly_is_held() -> None:
    found = experiment("lift", [NONE], trials=2, objects=["box", "ball"], jobs=1)
    assert found.mean(NONE.name) == found.success(NONE.name, "box") == 0
    assert all(isinstance(each, Lifting) and each.peak < 1 for each in found.all(NONE.name))


def test_a_rule_takes_the_threshold_of_the_detectors_card() -> None:
    card = load_debounce("tcn")
    assert card
    grips = {rule: Method("tcn", rule).grip() for rule in RULES}
    assert {grip.threshold for grip in grips.values()} == {card.threshold}
    assert isinstance(grips["steps"], StepGrip)
    none = grips["none"]
    assert isinstance(none, Grip)
    assert none.gain == 0


@pytest.mark.parametrize("values", [{"trials": 0}, {"methods": []}, {"jobs": 0}, {"objects": ["jug"]}])
def test_what_cannot_be_is_refused(values: dict[str, object]) -> None:
    given: dict[str, object] = {"methods": [NONE], "trials": 1, "conditions": Conditions(), **values}
    with pytest.raises(ParameterError):
        experiment("tap", **given)  # type: ignore[arg-type]


def test_an_unknown_object_is_named_as_an_object() -> None:
    with pytest.raises(ParameterError, match="object is 'nope', must be one of box, ball"):
        experiment("lift", [NONE], trials=1, objects=["nope"], jobs=1)


def test_an_unknown_rule_or_detector_is_named() -> None:
    with pytest.raises(InputError, match="ours, steps, none"):
        Method("tcn", "best").grip()
    with pytest.raises(InputError, match="no detector"):
        experiment("lift", [Method("tcm")], trials=1, jobs=1)

from typing import Any

import pytest

from flows.lab.experiments.lift_trial import lift
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.study import SEED, Study, Trials, run_study
from flows.lab.experiments.tap_trial import tap
from operators import ParameterError

NONE, STEPS = Method("psd", "none"), Method("psd", "steps")


@pytest.fixture(scope="module")
def study() -> Study:
    return run_study(lift, [NONE, STEPS], Trials(2, objects=("box", "ball")), jobs=1)


def test_each_method_runs_the_same_trials(study: Study) -> None:
    for method in (NONE, STEPS):
        trials = study.of(method).select("condition", "object", "seed").rows()
        assert trials == [("nominal", name, SEED + k) for name in ("box", "ball") for k in (0, 1)]
    assert study.outcomes["slide"].n_unique() > 4  # trials differ


def test_processes_and_the_number_of_trials_change_no_trial(study: Study) -> None:
    seen: list[tuple[int, int, str]] = []
    again = run_study(
        lift,
        [NONE],
        Trials(1, objects=("box", "ball")),
        jobs=2,
        progress=lambda done, total, label: seen.append((done, total, label)),
    )
    assert again.outcomes.equals(study.of(NONE).filter(seed=SEED))
    assert seen == [(0, 2, ""), (1, 2, "nominal"), (2, 2, "nominal")]


def test_without_control_no_object_is_held(study: Study) -> None:
    outcomes = study.of(NONE)
    assert not outcomes["success"].any()
    assert (outcomes["peak"] < 1).all()
    assert outcomes["force"].is_null().all()


@pytest.mark.parametrize("values", [{"methods": []}, {"conditions": {}}, {"jobs": 0}])
def test_an_empty_study_is_refused(values: dict[str, Any]) -> None:
    given: dict[str, Any] = {"methods": [NONE], "trials": Trials(1), **values}
    with pytest.raises(ParameterError, match=r"experiment: .* must be at least 1"):
        run_study(tap, **given)


def test_an_unknown_object_is_named() -> None:
    with pytest.raises(ParameterError, match="object is 'nope', must be one of box, ball"):
        Trials(1, objects=("nope",))
    with pytest.raises(ParameterError, match="count is 0, must be at least 1"):
        Trials(0)

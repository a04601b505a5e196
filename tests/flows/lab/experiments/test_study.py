from dataclasses import fields

import polars as pl
import pytest

from flows.lab.experiments.rivals import Method
from flows.lab.experiments.study import AXES, NOMINAL, SEED, Trials, axes_of, conditions_of, run_study
from flows.lab.experiments.trial import Conditions
from flows.run.executor import workers
from operators import ParameterError

NONE, STEPS = Method("psd", "none"), Method("psd", "steps")
TWO = Trials(2, objects=("box", "ball"))


@pytest.fixture(scope="module")
def results() -> pl.DataFrame:
    return run_study("lift", [NONE, STEPS], TWO)


def test_each_method_runs_the_same_trials(results: pl.DataFrame) -> None:
    for method in (NONE, STEPS):
        rows = results.filter(method=str(method), metric="trials")
        trials = [(NOMINAL, name, f"{name}-{SEED + k}", 1.0) for name in ("box", "ball") for k in (0, 1)]
        assert rows.select("condition", "fold", "recording", "value").rows() == trials
    assert results.filter(metric="slide")["value"].n_unique() > 4  # trials differ


def test_each_trial_has_one_ending(results: pl.DataFrame) -> None:
    endings = results.filter(pl.col("metric").str.starts_with("ending "))
    assert endings.group_by("method", "recording").len()["len"].to_list() == [1] * 8


def test_processes_and_the_number_of_trials_change_no_trial(results: pl.DataFrame) -> None:
    seen: list[tuple[int, int]] = []
    with workers(2) as executor:
        again = run_study(
            "lift",
            [NONE],
            Trials(1, objects=("box", "ball")),
            executor=executor,
            progress=lambda done, total: seen.append((done, total)),
        )
    same = pl.col("recording").str.ends_with(str(SEED))
    assert again.equals(results.filter(same, method=str(NONE)))
    assert seen == [(0, 2), (1, 2), (2, 2)]


def test_without_control_no_object_is_held(results: pl.DataFrame) -> None:
    found = results.filter(method=str(NONE))
    assert found.filter(metric="success")["value"].sum() == 0
    assert (found.filter(metric="peak")["value"] < 1).all()
    assert found.filter(metric="force").is_empty()


def test_an_empty_study_and_unknown_names_are_refused() -> None:
    with pytest.raises(ParameterError, match="experiment: methods is 0, must be at least 1"):
        run_study("tap", [], TWO)
    with pytest.raises(ParameterError, match="name is 'drop', must be one of tap, lift"):
        run_study("drop", [NONE], TWO)
    with pytest.raises(ParameterError, match="object is 'nope', must be one of box, ball"):
        Trials(1, objects=("nope",))
    with pytest.raises(ParameterError, match="count is 0, must be at least 1"):
        Trials(0)


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
    assert len(conditions_of("lift", stress=True)) == 1 + sum(len(values) - 1 for values in AXES.values())
    assert list(conditions_of("tap", stress=False)) == [NOMINAL]

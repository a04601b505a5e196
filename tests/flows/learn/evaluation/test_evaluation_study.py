import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from flows.learn.evaluation.evaluation_study import Evaluation, evaluate, judge_all
from flows.learn.evaluation.folds import Fold, group_folds
from flows.learn.evaluation.methods import PAPER_RULE, FittedMethod, Learner, hold_out_methods
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.measures import BALANCED, SHARES
from flows.learn.training.recipe import Recipe
from flows.report.results import estimates
from flows.run.executor import workers
from operators.detectors import Detector, Psd
from operators.errors import InputError
from operators.fingertip import TAKKTILE
from tests.flows.learn.conftest import Trained
from tests.flows.learn.evaluation.conftest import Having

SMALL = Recipe(filters=4, units=4, steps=40, batch=8, checks=2, rate=2e-2)


def sums(found: Evaluation) -> dict[str, float]:
    parts = found.results.group_by("metric")
    return {str(name): float(part["value"].sum()) for (name,), part in parts}


def test_the_most_accurate_comes_first(found: Evaluation) -> None:
    shares = estimates(found.results, SHARES).filter(statistic="accuracy %")
    accuracy = dict(shares.select("method", "value").rows())
    assert list(found.methods) == sorted(accuracy, key=lambda name: -accuracy[name])
    assert found.results["method"].unique(maintain_order=True).to_list() == [*found.methods]
    assert found.leader == "tcn", "the default, whatever its place"


def test_a_method_without_any_probability_comes_last(surfaces: list[LabelledRecording]) -> None:
    fold = Fold("", (), (), [surfaces[0].piece(slice(300))])
    tasks = [(FittedMethod(f"{length}", Psd(length), PAPER_RULE), fold) for length in (400, 25)]
    assert [*judge_all("", tasks).methods] == ["25", "400"]


def test_tasks_on_processes_give_the_same_results(found: Evaluation, tiny: Path) -> None:
    names = ["tcn", "psd"]
    with workers(2) as executor:
        again = evaluate(tiny, names=names, executor=executor)
    assert again.results.equals(found.results.filter(pl.col("method").is_in(names)))


def test_with_all_recordings_judged_nothing_is_fitted_or_tuned(tiny: Path) -> None:
    found = evaluate(tiny, names=["psd", "logistic", "tcn"], split="all")
    assert list(found.methods) == ["tcn"]
    assert set(found.missing) == {"psd", "logistic"}
    assert "no training with slip and static is left" in found.missing["psd"]


def test_methods_for_other_fingertips_are_missing_with_the_remedy(tiny: Path, having: Having) -> None:
    dataset = having([replace(each, fingertip=replace(TAKKTILE, rate=200.0)) for each in load(tiny)])
    found = evaluate(dataset, names=["tcn", "psd"], speed=1e-4)
    assert list(found.methods) == ["psd"]
    assert "Resample(rate=100)" in found.missing["tcn"]
    assert found.speeds["psd"] > 0
    with pytest.raises(InputError, match="tcn needs 100 Hz"):
        evaluate(dataset, names=["tcn"])


def test_a_recording_at_which_a_detector_gives_no_probability_is_named(tiny: Path, having: Having) -> None:
    recordings = load(tiny)
    broken = next(each for each in recordings if each.split == "test")
    recordings[recordings.index(broken)] = replace(broken, valid=np.zeros(broken.counts.shape, np.bool_))
    found = evaluate(having(recordings), names=["psd"])
    assert [*found.notes] == ["psd gave no probability at any labelled sample of 1 recording"]


def test_a_recording_in_two_splits_is_named_and_not_fitted_to(tiny: Path, having: Having) -> None:
    clean, everything = evaluate(tiny, names=["psd"]), load(tiny)
    copies = [replace(each, name="copy", split="train") for each in everything if each.split == "test"]
    found = evaluate(having([*everything, copies[0]]), names=["psd"])
    [note] = found.notes
    assert note.startswith("copy (train) is the same recording as ")
    assert sums(found) == sums(clean)


def test_a_model_that_was_trained_on_judged_recordings_is_named(small: Trained, tiny: Path) -> None:
    path = str(small.model.path)
    for split, notes in (("validation", [f"{path} has learned from 1 recording of these"]), ("test", [])):
        assert [*evaluate(tiny, names=["psd", path], split=split).notes] == notes


def test_detectors_are_judged_on_groups_that_they_did_not_see(surfaces: list[LabelledRecording]) -> None:
    done = list[tuple[int, int]]()
    methods = hold_out_methods(["psd", "logistic", "tcn"], train=True, recipe=SMALL)
    [fold] = group_folds(surfaces, ["wood"], "strokes")
    tasks = [(each, fold) for each in methods]
    found = judge_all("strokes", tasks, progress=lambda number, of: done.append((number, of)))
    assert done[-1] == (3, 3)
    assert set(found.methods) == {"psd", "logistic", "tcn, trained"}
    balanced = estimates(found.results, BALANCED, ("method", "fold"))
    assert balanced.filter(method="logistic")["fold"].to_list() == ["wood"]
    for method in ("logistic", "tcn, trained"):
        assert min(balanced.filter(method=method)["value"]) > 90


def test_a_learner_that_fails_on_one_group_is_missing(
    surfaces: list[LabelledRecording], having: Having
) -> None:
    still = [
        each if each.group == "steel" else replace(each, label=np.zeros_like(each.label)) for each in surfaces
    ]
    found = evaluate(having(still), hold_out=["all"], train=True, names=["psd", "logistic"])
    assert list(found.methods) == ["psd"]
    assert found.missing["logistic"]


def test_a_method_that_is_not_judged_on_groups_is_named(
    surfaces: list[LabelledRecording], having: Having
) -> None:
    for names in (["logistic"], ["tcn", "logistic"]):
        with pytest.raises(InputError, match=r"^logistic: is not judged on groups: .*with --train"):
            evaluate(having(surfaces), hold_out=["all"], names=names)


def test_fingertips_of_a_session_are_one_recording_so_that_they_do_not_narrow_an_interval(
    surfaces: list[LabelledRecording], having: Having
) -> None:
    one = [replace(each, split="test") for each in surfaces]
    intervals = [
        estimates(evaluate(having(given), names=["tcn"]).results, BALANCED)["low", "high"].rows()
        for given in (one, [*one, *one])
    ]
    assert intervals[0] == intervals[1] != [(None, None)]


def die(_: Fold) -> Detector:
    os._exit(1)


def test_a_method_whose_process_dies_is_missing(surfaces: list[LabelledRecording]) -> None:
    fold, methods = Fold("", (), (), surfaces[:1]), [*hold_out_methods(), Learner("own", die)]
    with workers(2) as executor:
        found = judge_all("strokes", [(each, fold) for each in methods], executor=executor)
    assert list(found.methods) == ["psd"]
    assert found.missing == {"own": "its process died, perhaps for lack of memory"}

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.learn.evaluation import evaluation_study as module
from flows.learn.evaluation.evaluation_study import Evaluation, MethodResult, evaluate
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.scoring import probabilities
from flows.learn.training.recipe import Recipe
from flows.learn.training.trainer import train
from operators import Debounce
from operators.batch import Codes, Reals
from operators.detectors import Detector
from operators.errors import InputError


def psd(found: Evaluation) -> MethodResult:
    [result] = [result for result in found.results if result.method.name == "psd"]
    return result


def test_the_scores_are_those_of_the_test_split(found: Evaluation, tiny: Path) -> None:
    recordings = [recording for recording in load(tiny) if recording.split == "test"]
    result = psd(found)
    called = [probabilities(result.method.detector, recording)[99:] >= 0.5 for recording in recordings]
    truth = [recording.slip[99:] for recording in recordings]
    expected = Confusion.of(np.concatenate(called), np.concatenate(truth))
    assert result.confusion.counts.tolist() == expected.counts.tolist()
    assert result.motions.confusion().counts.tolist() == expected.counts.tolist()
    assert result.changes.errors.sum() == expected.counts[0, 1] + expected.counts[1, 0]
    assert result.reliability.number.sum() == found.samples == expected.counts.sum()
    assert found.recordings == len(recordings)


def test_the_most_accurate_comes_first(found: Evaluation) -> None:
    accuracy = [result.confusion.accuracy for result in found.results]
    assert accuracy == sorted(accuracy, reverse=True)
    assert {result.method.name for result in found.results} == {"psd", "logistic", "tcn"}


def test_a_simulated_dataset_is_compared_with_the_truth_too(found: Evaluation) -> None:
    itself = found.label
    assert (itself["arm-speed"].balanced, itself["arm-speed"].onset_ms) == (100, 0)
    assert 70 < itself["sliding"].balanced < 99
    assert itself["sliding"].lead_ms == 0
    for result in found.results:
        by_speed, by_sliding = result.performance["arm-speed"], result.performance["sliding"]
        assert (by_speed.balanced, by_speed.onset_ms) == (result.confusion.balanced, result.events.onset_ms)
        assert by_speed != by_sliding
        assert by_speed.lead_ms == by_sliding.lead_ms


def test_true_sliding_is_unknown_if_the_dataset_does_not_have_it(
    tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(dataset: Path, **_: object) -> list[LabelledRecording]:
        return [replace(each, sliding=None) for each in load(dataset)]

    monkeypatch.setattr(module, "load", unknown)
    found = evaluate(tiny, names=["psd"])
    assert found.label.keys() == psd(found).performance.keys() == {"arm-speed"}


def test_without_a_validation_split_the_papers_debounce_is_used(
    tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def some(dataset: Path, **_: object) -> list[LabelledRecording]:
        return [
            replace(each, split="train") if each.split == "validation" else each for each in load(dataset)
        ]

    monkeypatch.setattr(module, "load", some)
    result = psd(evaluate(tiny, names=["psd"]))
    assert result.debounce == Debounce(0.5, 2, 2)
    assert result.chosen_on.startswith("the paper")
    assert result.events.false_alarms == result.paper_rule.false_alarms


def _doubtful(label: Codes) -> Codes:
    return np.where(np.arange(len(label)) // 100 == 5, -1, label).astype(np.int8)


def test_samples_with_unknown_labels_are_not_evaluated(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def doubtful(dataset: Path, **_: object) -> list[LabelledRecording]:
        return [replace(each, label=_doubtful(each.label)) for each in load(dataset)]

    monkeypatch.setattr(module, "load", doubtful)
    found = evaluate(tiny, names=["tcn"], split="all")
    lengths = [len(recording) for recording in load(tiny)]
    assert found.samples == sum(length - 99 - 100 for length in lengths)


def test_a_missing_split_dataset_or_method_is_refused(tiny: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no split 'holdout'; it has test, train, validation"):
        evaluate(tiny, split="holdout")
    with pytest.raises(InputError, match="holds no labelled samples"):
        evaluate(tmp_path)
    with pytest.raises(InputError, match="oracle: is not a method"):
        evaluate(tiny, names=["oracle"])


def test_with_all_recordings_judged_nothing_is_fitted_or_tuned(tiny: Path) -> None:
    logged: list[str] = []
    found = evaluate(tiny, names=["psd", "logistic", "tcn"], split="all", log=logged.append)
    assert [result.method.name for result in found.results] == ["tcn"]
    assert set(found.missing) == {"psd", "logistic"}
    assert "evaluated recordings do not count" in found.missing["psd"]


def test_a_judged_split_does_not_tune_the_debounce(tiny: Path) -> None:
    found = evaluate(tiny, names=["psd"], split="validation")
    assert psd(found).chosen_on.startswith("the paper")


def test_a_copy_of_a_judged_recording_is_named_and_not_fitted_to(
    tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clean = evaluate(tiny, names=["psd"])

    def copied(dataset: Path, **_: object) -> list[LabelledRecording]:
        everything = load(dataset)
        test = [each for each in everything if each.split == "test"]
        return [*everything, *(replace(each, name=f"copy of {each.name}", split="train") for each in test)]

    monkeypatch.setattr(module, "load", copied)
    logged: list[str] = []
    found = evaluate(tiny, names=["psd"], log=logged.append)
    [leak] = found.leaks
    assert leak.kind == "shared rows"
    assert f"leak: {leak.finding}" in logged
    assert psd(found).confusion.counts.tolist() == psd(clean).confusion.counts.tolist()


def test_a_model_that_was_trained_on_judged_recordings_is_named(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "small.safetensors"
    train([tiny], out, recipe=Recipe(filters=4, units=4, steps=2, batch=4))
    kinds = dict[str, list[str]]()
    for split in ("train", "validation", "test"):
        leaks = evaluate(tiny, names=["psd"], models=[out], split=split).leaks
        kinds[split] = [leak.kind for leak in leaks if leak.kind != "constant answer"]  # hardly trained
    assert kinds == {"train": ["trained on"], "validation": ["chosen on"], "test": []}


def test_a_constant_answer_is_named(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unmoved(_detector: Detector, recording: LabelledRecording) -> Reals:
        return np.full(len(recording), 0.2)

    monkeypatch.setattr(module, "probabilities", unmoved)
    [leak] = evaluate(tiny, names=["psd"]).leaks
    assert leak.kind == "constant answer"
    assert leak.finding.startswith("psd answers static for every sample")

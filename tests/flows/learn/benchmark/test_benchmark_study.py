import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest

from flows.learn.benchmark import entrants, folds
from flows.learn.benchmark.benchmark_report import benchmark_report
from flows.learn.benchmark.benchmark_study import Benchmark, EntrantResult, benchmark
from flows.learn.benchmark.entrants import REGIMES, Course
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.leaks.leak import SEEN, seen_recordings
from flows.learn.training import dense_training
from flows.learn.training.recipe import Recipe
from operators.errors import InputError, ParameterError
from operators.fingertip import TAKKTILE, Fingertip, grid
from storage import load_weights, save_weights
from storage.models import load_card, save_card, shipped

Having: TypeAlias = Callable[[Sequence[LabelledRecording]], Path]

SMALL = Recipe(filters=4, units=4, steps=40, batch=8, checks=2, rate=2e-2)


@pytest.fixture
def course(tmp_path: Path) -> Course:
    return Course(SMALL, tmp_path / "models")


def of(found: Benchmark, title: str) -> EntrantResult:
    [result] = [each for each in found.datasets[0].results if each.entrant.title == title]
    return result


@pytest.fixture(scope="module")
def fitted(surfaces: list[LabelledRecording], tmp_path_factory: pytest.TempPathFactory) -> Benchmark:
    """Return what logistic regression and the majority reach, few-shot and in-domain."""
    folder, parts = tmp_path_factory.mktemp("fitted"), list[tuple[int, int]]()

    def load(_dataset: Path, _rate: float | None = None) -> list[LabelledRecording]:
        return surfaces

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(folds, "load", load)
        found = benchmark(
            {"strokes": folder / "strokes"},
            Course(SMALL, folder / "models"),
            regimes=["few-shot", "in-domain"],
            names=["logistic", "majority"],
            jobs=1,
            progress=lambda done, total, _part: parts.append((done, total)),
        )
    assert parts[-1][0] == parts[-1][1]
    return found


def test_fitted_detectors_beat_the_majority_on_surfaces_that_they_never_saw(
    surfaces: list[LabelledRecording],
    having: Having,
    course: Course,
    fitted: Benchmark,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(entrants, "FEW_DRAWS", 1)
    regimes, names = ["few-shot", "in-domain"], ["gradient_boosting"]
    boosted = benchmark({"strokes": having(surfaces)}, course, regimes=regimes, names=names, jobs=1)
    for regime in regimes:
        assert of(fitted, f"{regime} logistic").figures.balanced.value > 85
        assert of(boosted, f"{regime} gradient_boosting").figures.balanced.value > 85
    majority = of(fitted, "in-domain majority").figures
    assert (majority.balanced.value, majority.events_per_min.value, majority.missed.value) == (50, 0, 100)
    assert of(fitted, "few-shot logistic").by_fold.keys() == {"steel", "wood", "wool"}
    assert fitted.datasets[0].leaks == ()


def test_a_last_piece_of_the_labelled_minutes_may_be_shorter_than_a_window(
    surfaces: list[LabelledRecording], having: Having, course: Course, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(entrants, "MINUTES", (3 * 700 + 2) / 6000)  # three recordings and two samples
    found = benchmark({"strokes": having(surfaces)}, course, regimes=["few-shot"], names=["logistic"], jobs=1)
    assert of(found, "few-shot logistic").figures.balanced.value > 85


def test_a_detector_is_fitted_without_the_recordings_that_judge_it(
    surfaces: list[LabelledRecording], having: Having, course: Course
) -> None:
    odd = [  # on wool the labels are swapped: who has seen wool knows
        replace(each, label=(1 - each.label).astype(np.int8)) if each.group == "wool" else each
        for each in surfaces
    ]
    found = benchmark(
        {"strokes": having(odd)}, course, regimes=["in-domain"], names=["gradient_boosting"], jobs=1
    )
    by_fold = of(found, "in-domain gradient_boosting").by_fold
    assert by_fold["wool"] < 20


def test_our_network_is_trained_once_per_fold_and_its_card_lists_the_others(
    surfaces: list[LabelledRecording],
    having: Having,
    course: Course,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def run(recipe: Recipe = SMALL, recordings: Sequence[LabelledRecording] = surfaces) -> Benchmark:
        again = replace(course, recipe=recipe)
        data = {"strokes": having(recordings)}
        return benchmark(data, again, regimes=["in-domain"], names=["tcn"], jobs=1)

    first = run()
    assert of(first, "in-domain tcn").figures.balanced.value > 80
    models = sorted(course.models.glob("*.safetensors"))
    assert len(models) == 3
    seen = [load_card(path)[SEEN] for path in models]
    assert sorted(sorted({*each["train"]["groups"], *each["validation"]["groups"]}) for each in seen) == [
        ["steel", "wood"],
        ["steel", "wool"],
        ["wood", "wool"],
    ]
    trained: list[int] = []
    train = dense_training.train_dense

    def counted(fit: Sequence[LabelledRecording], *rest: Any) -> object:  # noqa: ANN401 - passed on
        trained.append(len(fit))
        return train(fit, *rest)

    monkeypatch.setattr(dense_training, "train_dense", counted)
    assert of(run(), "in-domain tcn").figures == of(first, "in-domain tcn").figures
    assert trained == []
    swapped = replace(surfaces[0], label=(1 - surfaces[0].label).astype(np.int8))
    run(replace(SMALL, steps=2), [swapped, *surfaces[1:]])
    assert len(trained) == 3


def test_detectors_for_another_fingertip_are_listed_with_the_operator_that_converts(
    surfaces: list[LabelledRecording], having: Having, course: Course
) -> None:
    other = Fingertip(grid(4), 100.0)
    four = [replace(each, counts=each.counts[:, :4], fingertip=other) for each in surfaces]
    logged: list[str] = []
    found = benchmark(
        {"strokes": having(four)},
        course,
        regimes=["zero-shot", "in-domain"],
        names=["tcn", "logistic"],
        jobs=1,
        log=logged.append,
    )
    [dataset] = found.datasets
    assert "Pool(groups=...) in a flow converts it" in dataset.missing["zero-shot tcn"]
    assert any("no zero-shot tcn" in line for line in logged)
    titles = {each.entrant.title for each in dataset.results}
    assert titles == {"in-domain logistic", "in-domain tcn"}  # any number of cells


def test_a_detector_of_another_rate_is_judged_on_samples_converted_to_it(
    surfaces: list[LabelledRecording],
    monkeypatch: pytest.MonkeyPatch,
    course: Course,
    tmp_path: Path,
) -> None:
    ours = shipped("tcn")
    assert ours is not None
    fast = replace(TAKKTILE, rate=200.0)
    path = tmp_path / "fast.safetensors"
    save_weights(path, load_weights(ours)[0], {"detector": "tcn"})
    save_card(path, {"fingertip": fast.describe()})

    def at(rate: float | None) -> list[LabelledRecording]:
        rows = np.repeat(np.arange(700), 2) if rate in {None, 200.0} else np.arange(700)
        return [
            replace(
                each,
                counts=each.counts[rows],
                label=each.label[rows],
                fingertip=replace(TAKKTILE, rate=rate or 200.0),
            )
            for each in surfaces
        ]

    read: list[float | None] = []

    def load(_: Path, rate: float | None = None) -> list[LabelledRecording]:
        read.append(rate)
        return at(rate)

    monkeypatch.setattr(folds, "load", load)
    regimes, names = ["zero-shot", "in-domain"], ["tcn", "psd", "logistic"]
    found = benchmark({"strokes": tmp_path}, course, regimes=regimes, models=[path], names=names, jobs=1)
    assert read == [None, 100.0]
    [dataset] = found.datasets
    assert not dataset.missing
    assert dataset.data.fingertip.rate == 200
    assert dataset.data.notes == ("tcn, psd: at 100 Hz, converted by Resample",)
    slow_surfaces = at(100.0)

    def load_slow(_: Path, _rate: float | None = None) -> list[LabelledRecording]:
        return slow_surfaces

    monkeypatch.setattr(folds, "load", load_slow)
    slow = benchmark({"strokes": tmp_path}, course, regimes=["zero-shot"], names=["tcn", "psd"], jobs=1)
    for title in ("zero-shot tcn", "zero-shot psd"):
        assert of(found, title).figures == of(slow, title).figures
    for title in ("zero-shot fast", "in-domain logistic"):
        assert np.isfinite(of(found, title).figures.balanced.value)
    report = benchmark_report(found, "slipflow benchmark strokes")
    assert "at 100 Hz, converted by Resample" in report.sections[0].text


def test_a_model_that_saw_a_judged_recording_is_named_and_not_the_best(
    surfaces: list[LabelledRecording], having: Having, course: Course, tmp_path: Path
) -> None:
    path = tmp_path / "own.safetensors"
    ours = shipped("tcn")
    assert ours is not None
    save_weights(path, load_weights(ours)[0], {"detector": "tcn"})
    save_card(path, {SEEN: seen_recordings([replace(surfaces[4], split="train")])})
    logged: list[str] = []
    found = benchmark(
        {"strokes": having(surfaces)},
        course,
        regimes=["zero-shot"],
        models=[path],
        names=["psd"],
        jobs=1,
        log=logged.append,
    )
    [leak] = of(found, "zero-shot own").leaks
    assert leak.kind == "trained on"
    assert surfaces[4].name in leak.finding
    assert f"strokes: leak: {leak.finding}" in logged
    best = found.datasets[0].best("zero-shot")
    assert best is None or best.entrant.name == "psd"
    report = benchmark_report(found, "slipflow benchmark strokes")
    assert leak.finding in report.markdown("benchmark")
    assert leak.json() in report.json()["datasets"]["strokes"]["leaks"]


def test_the_page_says_how_many_labelled_minutes_there_are_for_few_shots(fitted: Benchmark) -> None:
    assert of(fitted, "few-shot logistic").notes == ("0.7 min available",)
    assert of(fitted, "in-domain logistic").notes == ()


def test_a_group_can_be_left_out(surfaces: list[LabelledRecording], having: Having, course: Course) -> None:
    data, names = {"strokes": having(surfaces)}, ["majority"]
    found = benchmark(data, course, regimes=["in-domain"], names=names, groups=["wool", "wood"], jobs=1)
    assert of(found, "in-domain majority").by_fold.keys() == {"wood", "wool"}
    assert {each.group for each in found.datasets[0].data.recordings} == {"wood", "wool"}
    with pytest.raises(InputError, match="has no recordings of oak; its groups: steel, wood, wool"):
        benchmark(data, course, regimes=["in-domain"], names=names, groups=["oak"], jobs=1)


@pytest.mark.parametrize(
    ("in_domain", "tables"), [(90.0, [[["few-shot", "tcn", 50.0, 50.0, 50.0]]]), (60.0, []), (40.0, [])]
)
def test_the_page_gives_the_share_of_the_gap_that_few_shots_close_if_there_is_a_gap(
    surfaces: list[LabelledRecording],
    having: Having,
    course: Course,
    in_domain: float,
    tables: list[list[list[str | float]]],
) -> None:
    found = benchmark({"strokes": having(surfaces)}, course, regimes=["zero-shot"], names=["tcn"], jobs=1)
    [dataset] = found.datasets
    zero = dataset.results[0]
    by_regime = list(zip(REGIMES, (60.0, 75.0, in_domain), strict=True))
    results = tuple(
        replace(
            zero, entrant=replace(zero.entrant, regime=regime), by_fold=dict.fromkeys(zero.by_fold, value)
        )
        for regime, value in by_regime
    )
    report = benchmark_report(replace(found, datasets=(replace(dataset, results=results),)), "x")
    [section] = [each for each in report.sections if each.name == "strokes-folds"]
    assert [each.rows for each in section.tables[1:]] == tables


def test_the_page_has_every_figure_and_its_interval(
    surfaces: list[LabelledRecording], fitted: Benchmark
) -> None:
    report = benchmark_report(fitted, "slipflow benchmark strokes")
    names = ["strokes", "strokes-events", "strokes-folds", "strokes-leaks"]
    assert [section.name for section in report.sections] == names
    assert report.html().count("<svg ") == 2
    page = json.loads(json.dumps(report.json(), allow_nan=False))
    [best] = [
        each
        for each in page["datasets"]["strokes"]["results"]
        if each["regime"] == "in-domain" and each["detector"] == "logistic"
    ]
    figures = of(fitted, "in-domain logistic").figures
    assert best["balanced"]["value"] == pytest.approx(figures.balanced.value, rel=1e-5)
    assert best["balanced"]["low"] <= best["balanced"]["value"] <= best["balanced"]["high"]
    assert 0 <= best["calibration"]["value"] < 50
    assert {"area", "calibration", "events_per_min", "false_alarms_per_min", "missed", "delay"} <= best.keys()
    assert figures.balanced.interval() in report.title
    assert page["datasets"]["strokes"]["folds"]["wood"] == [each.name for each in surfaces[3:6]]


def test_the_page_says_if_few_recordings_have_slip(
    surfaces: list[LabelledRecording], having: Having, course: Course
) -> None:
    few = [replace(each, label=np.zeros_like(each.label)) for each in surfaces[2:]]
    for recordings, expected in (
        (surfaces, "43 % slip, in"),
        ([*surfaces[:2], *few], "(only in 2 recordings)"),
    ):
        data = {"strokes": having(recordings)}
        found = benchmark(data, course, regimes=["in-domain"], names=["majority"], jobs=1)
        assert expected in benchmark_report(found, "slipflow benchmark strokes").sections[0].text


def test_unknown_regimes_and_detectors_are_refused(
    surfaces: list[LabelledRecording], having: Having, course: Course
) -> None:
    data = {"strokes": having(surfaces)}
    with pytest.raises(ParameterError, match="regime is 'none'"):
        benchmark(data, course, regimes=["none"])
    with pytest.raises(ParameterError, match="method is 'oracle'"):
        benchmark(data, course, names=["oracle"])

import json
import re
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from numpy.typing import NDArray

from flows.learn.chart import chart_page
from flows.learn.chart import speed_accuracy as module
from flows.learn.chart.speed_accuracy import ONNX, TORCH, Chart, chart
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.scoring import probabilities
from operators.errors import InputError
from storage import load_detector
from storage.models import save_weights

EXTRAS = {TORCH: find_spec("torch"), ONNX: find_spec("onnx") and find_spec("onnxruntime")}


@pytest.fixture(scope="module")
def small(
    unlearned: Callable[[int], dict[str, NDArray[Any]]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("models") / "tcn4.safetensors"
    save_weights(path, unlearned(4), {"detector": "tcn"})
    return path


@pytest.fixture(scope="module")
def found(tiny: Path, small: Path) -> Chart:
    """Of the TCN that ships, a small one that has learned nothing, and the PSD threshold."""
    return chart(tiny, [small], names=["tcn", "psd"], span=1e-4)


def test_every_detector_is_a_point_and_so_is_the_default_by_other_libraries(found: Chart) -> None:
    names = {point.name for point in found.points}
    assert names == {"tcn", "tcn4", "psd", *(name for name, there in EXTRAS.items() if there)}
    assert names.isdisjoint(found.skipped)
    assert {point.name for point in found.points if point.streams} == {"tcn", "tcn4"}
    assert all(point.us > 0 and point.us_64 > 0 for point in found.points)


def test_the_accuracy_is_that_on_the_test_split(found: Chart, tiny: Path, small: Path) -> None:
    test = [recording for recording in load(tiny) if recording.split == "test"]
    detector = load_detector(small)
    called = [probabilities(detector, recording)[99:] >= 0.5 for recording in test]
    expected = Confusion.of(
        np.concatenate(called), np.concatenate([recording.slip[99:] for recording in test])
    )
    [point] = [point for point in found.points if point.name == "tcn4"]
    assert (point.judged.accuracy, point.judged.balanced) == (expected.accuracy, expected.balanced)
    assert found.recordings == len(test)


def test_the_default_by_another_library_is_as_right(found: Chart) -> None:
    accuracy = {point.name: point.judged.accuracy for point in found.points}
    same = [point.name for point in found.points if point.same]
    assert set(same) == {name for name, there in EXTRAS.items() if there}
    for name in same:
        assert accuracy[name] == pytest.approx(accuracy["tcn"], abs=0.1)


def test_the_goals_are_ratios_of_the_points(found: Chart) -> None:
    us = {point.name: point.us for point in found.points}
    goals = found.goals()
    ratios = [us[name] / us["tcn"] for name in (TORCH, ONNX) if name in us]
    assert [goal.reached for goal in goals[:-1]] == ratios
    assert goals[-1].reached == next(point.core_64 for point in found.points if point.name == "tcn")


def test_without_the_default_there_are_no_goals_and_nothing_to_compare_it_with(tiny: Path) -> None:
    told = list[str]()
    found = chart(tiny, names=["psd"], span=1e-4, told=told.append)
    assert [point.name for point in found.points] == ["psd"]
    assert found.goals() == []
    assert set(found.skipped) == {TORCH, ONNX}
    assert f"SKIPPED: {TORCH}, because there is no tcn" in told
    assert f"Not there: {TORCH}, because there is no tcn" in chart_page.page(found, "x").markdown()


def test_without_torch_it_says_so_and_goes_on(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        del name

    monkeypatch.setattr(module, "find_spec", missing)
    found = chart(tiny, names=["tcn"], span=1e-4)
    assert [point.name for point in found.points] == ["tcn"]
    assert found.skipped[TORCH] == "torch cannot be imported"
    assert found.skipped[ONNX] == "onnx and onnxruntime cannot be imported"
    assert len(found.goals()) == 1


def test_a_dataset_without_splits_is_refused(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without(dataset: Path) -> list[LabelledRecording]:
        return [each for each in load(dataset) if each.split != "test"]

    monkeypatch.setattr(module, "load", without)
    with pytest.raises(InputError, match="has no test split"):
        chart(tiny, names=["psd"])


def test_the_page_its_numbers_and_its_figure_are_written(found: Chart, tmp_path: Path) -> None:
    paths = chart_page.write(found, tmp_path / "out", "slipflow chart tiny")
    assert [path.name for path in paths] == ["chart.html", "chart.md", "chart.json", "chart.svg"]
    numbers = json.loads(paths[2].read_text())
    assert [point["name"] for point in numbers["points"]] == [point.name for point in found.points]
    assert numbers["paper"]["tcn"] == {"accuracy": 91.3, "us": None}
    [line] = [line for line in paths[1].read_text().splitlines() if line.startswith("| tcn4 ")]
    [point] = [point for point in found.points if point.name == "tcn4"]
    assert f"{point.judged.accuracy:.1f}" in line
    page = paths[0].read_text()
    assert "slipflow chart tiny" in page
    assert not re.search(r"(?:src|href)=.(?!#)", page), "needs no other file"
    root = ET.parse(paths[3]).getroot()  # noqa: S314 - ours
    drawn = {"".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"tcn", "tcn4", "psd", "paper's tcn, 91.3 %", "Pareto front"} <= drawn


def test_a_terminal_shows_the_points_from_fast_to_slow(found: Chart) -> None:
    lines = chart_page.text(found).splitlines()
    order = [point.name for point in sorted(found.points, key=lambda point: point.us)]
    shown = [line.split()[1] for line in lines if line.startswith("| ") and line.split()[1] in order]
    assert shown == order

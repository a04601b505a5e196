import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from numpy.typing import NDArray

from flows.learn.chart import chart_study as module
from flows.learn.chart.chart_report import chart_report, goals
from flows.learn.chart.chart_study import Chart, chart
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.scoring import probabilities
from operators.errors import InputError
from operators.fingertip import TAKKTILE
from storage import load_detector
from storage.models import save_weights

OTHERS = ("torch_eager_windowed", "onnxruntime_windowed")


@pytest.fixture(scope="module")
def small(
    unlearned: Callable[[int], dict[str, NDArray[Any]]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("models") / "tcn4.safetensors"
    save_weights(path, unlearned(4), {"detector": "tcn"})
    return path


@pytest.fixture(scope="module")
def found(tiny: Path, small: Path) -> Chart:
    """Return the chart of the shipped TCN, a small untrained one, and the PSD threshold."""
    return chart(tiny, [small], names=["tcn", "psd"], span=1e-4)


def test_every_detector_and_the_default_by_other_libraries_is_a_point(found: Chart) -> None:
    names = {point.name for point in found.points}
    assert names == {"tcn", "tcn4", "psd", *OTHERS}
    assert names.isdisjoint(found.missing)
    assert {point.name for point in found.points if point.streams} == {"tcn", "tcn4"}
    assert all(point.us > 0 and point.us_64 > 0 for point in found.points)


def test_detectors_for_other_fingertips_are_missing(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fast = [replace(each, fingertip=replace(TAKKTILE, rate=200.0)) for each in load(tiny)]

    def loading(_: Path) -> list[LabelledRecording]:
        return fast

    monkeypatch.setattr(module, "load", loading)
    found = chart(tiny, names=["tcn", "psd"], span=1e-4)
    [point] = found.points
    assert point.name == "psd"
    assert point.core_64 == pytest.approx(point.us_64 * 200 / 1e4)
    assert "Resample(rate=100)" in found.missing["tcn"]
    assert goals(found) == []
    with pytest.raises(InputError, match="tcn needs 100 Hz"):
        chart(tiny, names=["tcn"], span=1e-4)


def test_the_accuracy_is_that_on_the_test_split(found: Chart, tiny: Path, small: Path) -> None:
    test = [recording for recording in load(tiny) if recording.split == "test"]
    detector = load_detector(small)
    called = [probabilities(detector, recording)[99:] >= 0.5 for recording in test]
    expected = Confusion.of(
        np.concatenate(called), np.concatenate([recording.slip[99:] for recording in test])
    )
    [point] = [point for point in found.points if point.name == "tcn4"]
    assert (point.performance.accuracy, point.performance.balanced) == (expected.accuracy, expected.balanced)
    assert found.recordings == len(test)


def test_the_default_by_another_library_is_equally_accurate(found: Chart) -> None:
    accuracy = {point.name: point.performance.accuracy for point in found.points}
    same = [point.name for point in found.points if point.same]
    assert set(same) == set(OTHERS)
    for name in same:
        assert accuracy[name] == pytest.approx(accuracy["tcn"], abs=0.1)


def test_the_goals_are_ratios_of_the_points(found: Chart) -> None:
    us = {point.name: point.us for point in found.points}
    [section] = goals(found)
    reached = [us["torch_eager_windowed"] / us["tcn"], us["onnxruntime_windowed"] / us["tcn"]]
    reached.append(next(point.core_64 for point in found.points if point.name == "tcn"))
    met = [reached[0] >= 500, reached[1] >= 50, reached[2] <= 2]
    wanted = ["at least 500", "at least 50", "at most 2"]
    assert [row[1:] for row in section.tables[0].rows] == [
        [text, value, "yes" if good else "no"] for text, value, good in zip(wanted, reached, met, strict=True)
    ]
    assert section.finding == f"tcn meets {sum(met)} of 3 speed goals"


def test_without_the_default_there_are_no_goals_and_no_other_libraries(tiny: Path) -> None:
    found = chart(tiny, names=["psd"], span=1e-4)
    assert [point.name for point in found.points] == ["psd"]
    assert [section.name for section in chart_report(found, "x").sections] == ["chart"]


def test_a_dataset_without_splits_is_refused(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without(dataset: Path) -> list[LabelledRecording]:
        return [each for each in load(dataset) if each.split != "test"]

    monkeypatch.setattr(module, "load", without)
    with pytest.raises(InputError, match="has no test split"):
        chart(tiny, names=["psd"])


def test_the_page_its_numbers_and_its_figure_are_written(found: Chart, tmp_path: Path) -> None:
    paths = chart_report(found, "slipflow chart tiny").write(tmp_path / "out", "chart")
    assert [path.name for path in paths] == ["chart.html", "chart.md", "chart.json", "chart.svg"]
    rows = json.loads(paths[2].read_text())["sections"]["chart"]["tables"][0]["rows"]
    ordered = sorted(found.points, key=lambda point: point.us)
    assert [row["detector"] for row in rows][: len(ordered)] == [point.name for point in ordered]
    [paper] = [row for row in rows if row["detector"] == "paper's tcn"]
    assert (paper["accuracy %"], paper["us/sample"]) == (91.3, None)
    [line] = [line for line in paths[1].read_text().splitlines() if line.startswith("| tcn4 ")]
    [point] = [point for point in found.points if point.name == "tcn4"]
    assert f"{point.performance.accuracy:.1f}" in line
    [row] = [row for row in rows if row["detector"] == "tcn4"]
    sliding = point.performances["sliding"]
    expected = {
        "sliding: balanced %": sliding.balanced,
        "sliding: delay ms": sliding.onset_ms,
        "lead ms": sliding.lead_ms,
    }
    for name, value in expected.items():
        if np.isnan(value):
            assert row[name] is None
        else:
            assert row[name] == pytest.approx(value, rel=1e-5)
    page = paths[0].read_text()
    assert "slipflow chart tiny" in page
    assert not re.search(r"(?:src|href)=.(?!#)", page), "needs no other file"
    root = ET.parse(paths[3]).getroot()  # noqa: S314 - ours
    drawn = {"".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"tcn", "tcn4", "psd", "paper's tcn, 91.3 %", "Pareto front"} <= drawn

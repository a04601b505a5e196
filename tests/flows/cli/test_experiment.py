"""The command line of `slipflow experiment`."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from flows.lab.experiments import study
from flows.lab.experiments.trial import Outcome
from tests.command import slipflow

ONE = ["--method", "psd:none", "--object", "ball", "--trials", "1", "--jobs", "1"]


def no_constant(name: str) -> None:
    raise AssertionError(name)


@pytest.fixture
def no_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lose the object in each trial, without a simulation."""
    metrics = {"false_firm": True, "slide": 30.0, "lead": math.nan, "force": math.nan, "peak": 0.5}
    lost = Outcome("missed", False, metrics)

    def lift(_: Any, setups: list[Any]) -> list[tuple[None, Outcome]]:
        return [(None, lost)] * len(setups)

    monkeypatch.setattr(study, "EXPERIMENTS", {"lift": lift})


def test_a_tap_is_written_as_json_and_as_a_page_that_names_the_command(tmp_path: Path) -> None:
    slipflow("experiment", "tap", *ONE, "--out", str(tmp_path))
    found = json.loads((tmp_path / "tap.json").read_text(), parse_constant=no_constant)
    assert found["sections"]["tap"]["tables"][0]["rows"][0]["method"] == "psd, none"
    markdown = (tmp_path / "tap.md").read_text()
    assert "slipflow experiment tap --method psd:none --object ball" in markdown
    assert "nan" not in markdown


@pytest.mark.usefixtures("no_simulation")
def test_a_repeated_object_or_method_leaves_the_intervals_as_they_are(tmp_path: Path) -> None:
    found = list[Any]()
    for repeated in ([], ["--object", "ball", "--method", "psd:none"]):
        slipflow("experiment", "lift", *ONE, *repeated, "--out", tmp_path)
        found.append(json.loads((tmp_path / "lift.json").read_text())["sections"])
    assert found[0] == found[1] != {}

"""The command line of `slipflow experiment`."""

import json
from pathlib import Path
from unittest.mock import Mock

import pytest

from flows.lab.experiments import study
from operators.errors import InputError
from tests.command import error, slipflow

ONE = ["--method", "psd:none", "--object", "ball", "--trials", "1", "--jobs", "1"]


def no_constant(name: str) -> None:
    raise AssertionError(name)


def test_a_tap_is_written_as_json_and_as_a_page_that_names_the_command(tmp_path: Path) -> None:
    slipflow("experiment", "tap", *ONE, "--out", str(tmp_path))
    found = json.loads((tmp_path / "tap.json").read_text(), parse_constant=no_constant)
    assert found["sections"]["tap"]["tables"][0]["rows"][0]["method"] == "psd, none"
    markdown = (tmp_path / "tap.md").read_text()
    assert "slipflow experiment tap --method psd:none --object ball" in markdown
    assert "nan" not in markdown


def test_a_repeated_object_or_method_counts_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "run_study", given := Mock(side_effect=InputError("lift", "is enough")))
    error("experiment", "lift", *ONE, *ONE, "--out", tmp_path)
    _, methods, trials = given.call_args.args
    assert (methods, trials.objects) == ([study.Method("psd", "none")], ("ball",))

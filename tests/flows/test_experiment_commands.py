"""`slipflow experiment` as a user meets it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from flows.experiment_commands import app

ONE = ["--method", "psd", "--object", "ball", "--trials", "1", "--jobs", "1"]


def _output(tmp_path: Path, *arguments: str) -> str:
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_lift_is_told_as_tables_and_written_as_a_page(tmp_path: Path) -> None:
    text = _output(tmp_path, "lift", *ONE, "--rule", "none", "--rule", "steps")
    assert "| psd, none " in text
    assert "| psd, steps " in text
    assert "| paper, real objects |   35 | 35.0 |" in text
    assert {path.suffix for path in tmp_path.iterdir()} >= {".html", ".md", ".json"}
    assert "slipflow experiment lift --method psd --trials 1" in (tmp_path / "lift.md").read_text()


@pytest.mark.parametrize("kind", ["tap", "lift"])
def test_a_program_reads_one_object(kind: str, tmp_path: Path) -> None:
    found = json.loads(_output(tmp_path, kind, *ONE, "--json").splitlines()[-1])
    assert found["experiment"] == kind
    assert found["trials"] == 1
    assert 0 <= found["mean_success"] <= 100
    assert list(found["objects"]) == ["ball"]
    assert "failures" in found


def test_delay_rate_path_and_hand_are_taken(tmp_path: Path) -> None:
    more = ["--delay", "50", "--rate", "50", "--path", "mqtt", "--locks", "--json"]
    assert json.loads(_output(tmp_path, "lift", *ONE, *more).splitlines()[-1])["trials"] == 1
    assert CliRunner().invoke(app, ["lift", *ONE, "--path", "post"]).exit_code == 2

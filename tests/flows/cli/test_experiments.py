"""The command line of `slipflow experiment`."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from flows.cli.experiments import app
from flows.report import figures

ONE = ["--method", "psd", "--object", "ball", "--trials", "1", "--jobs", "1"]


def _output(tmp_path: Path, *arguments: str) -> str:
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_lift_is_printed_as_tables_and_written_as_a_report(tmp_path: Path) -> None:
    text = _output(tmp_path, "lift", *ONE, "--rule", "none", "--rule", "steps")
    assert "| psd, none " in text
    assert "| psd, steps " in text
    assert "| paper, real objects |   35 | 35.0 |" in text
    assert {path.suffix for path in tmp_path.iterdir()} >= {".html", ".md", ".json"}
    again = "experiment lift --trials 1 --method psd --rule none --rule steps --object ball\n"
    assert again in (tmp_path / "lift.md").read_text()


def _no_constant(name: str) -> None:
    raise AssertionError(name)


def test_unknown_values_are_null_in_json_and_a_dash_in_tables(tmp_path: Path) -> None:
    text = _output(tmp_path, "lift", *ONE, "--rule", "none", "--json")
    for found in (text.splitlines()[-1], (tmp_path / "lift.json").read_text()):
        [costs] = json.loads(found, parse_constant=_no_constant)["sections"]["costs"]["tables"]
        assert costs["rows"][-1]["force"] is None
    page = (tmp_path / "lift.md").read_text()
    assert "nan" not in page
    assert "psd, none holds in 0 of 1 trials (0.0 %)" in page
    assert "mm and holds nothing" in page


def test_the_log_says_what_figures_need(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(_: str) -> None:
        return None

    monkeypatch.setattr(figures, "find_spec", nothing)
    result = CliRunner().invoke(app, ["lift", *ONE, "--rule", "none", "--out", str(tmp_path)])
    assert "no figures, which need matplotlib: in the clone, pip install -e '.[report]'" in result.stderr
    assert not (tmp_path / "lift.svg").exists()


@pytest.mark.parametrize("kind", ["tap", "lift"])
def test_json_of_one_object(kind: str, tmp_path: Path) -> None:
    found = json.loads(_output(tmp_path, kind, *ONE, "--json").splitlines()[-1])
    assert found["experiment"] == kind
    assert found["trials"] == 1
    assert 0 <= found["mean_success"] <= 100
    assert list(found["objects"]) == ["ball"]
    assert "failures" in found


def test_delay_rate_path_and_gripper_are_options(tmp_path: Path) -> None:
    more = ["--delay", "50ms", "--rate", "50", "--path", "mqtt", "--locks", "--json"]
    assert json.loads(_output(tmp_path, "lift", *ONE, *more).splitlines()[-1])["trials"] == 1
    again = "--trials 1 --method psd --object ball --path mqtt --delay 50ms --rate 50 --locks"
    assert again in (tmp_path / "lift.md").read_text()
    result = CliRunner().invoke(app, ["lift", *ONE, "--path", "post", "--out", str(tmp_path)])
    assert "--path is 'post', must be one of direct, mqtt" in str(result.exception)


def test_an_ablation_is_printed_and_written(tmp_path: Path) -> None:
    text = _output(tmp_path, "lift", *ONE, "--rule", "none", "--ablation")
    assert "psd, none: 1 trial of each object, too few to find where it breaks" in text
    assert {path.name for path in tmp_path.iterdir()} >= {"lift-ablation.html", "lift-ablation.json"}
    page = (tmp_path / "lift-ablation.md").read_text()
    assert "lift --trials 1 --method psd --rule none --object ball --ablation" in page


@pytest.mark.parametrize("more", [["--stress"], ["--delay", "50ms"], ["--locks"]])
def test_an_ablation_takes_no_conditions(more: list[str], tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["lift", *ONE, "--ablation", *more, "--out", str(tmp_path)])
    assert result.exit_code == 2


def test_an_ablation_follows_the_rule_without_a_method(tmp_path: Path) -> None:
    arguments = ["lift", "--object", "ball", "--trials", "1", "--jobs", "1", "--rule", "none", "--ablation"]
    text = _output(tmp_path, *arguments)
    assert "tcn_grasp, none: 1 trial" in text
    assert "tcn, none: 1 trial" in text
    assert "steps" not in text
    assert (
        "lift --trials 1 --rule none --object ball --ablation" in (tmp_path / "lift-ablation.md").read_text()
    )


@pytest.mark.parametrize("more", [["--method", "tcn"], ["--rule", "none", "--rule", "steps"]])
def test_a_stress_takes_one_method_and_one_rule(more: list[str], tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["lift", *ONE, "--stress", *more, "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "--stress takes one --method and one --rule" in result.output

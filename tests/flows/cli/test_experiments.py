"""The command line of `slipflow experiment`."""

import importlib.util
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from flows.cli.experiments import experiment as app
from flows.lab.experiments import lift_trial
from flows.lab.experiments.break_report import AXES
from flows.lab.experiments.lift_trial import LiftOutcome
from operators import InputError

ONE = ["--method", "psd", "--object", "ball", "--trials", "1", "--jobs", "1"]


def _output(folder: Path, *arguments: str) -> str:
    result = CliRunner().invoke(app, [*arguments, "--out", str(folder)])
    assert result.exit_code == 0, result.output
    return result.stdout


def _no_constant(name: str) -> None:
    raise AssertionError(name)


@pytest.fixture(scope="module")
def lifted(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """The output of a simulated lift, and the folder of its report."""
    folder = tmp_path_factory.mktemp("lift")
    return _output(folder, "lift", *ONE, "--seed", "0", "--rule", "none", "--rule", "steps"), folder


@pytest.fixture
def no_simulation(monkeypatch: pytest.MonkeyPatch, hide_packages: Callable[..., None]) -> None:
    """Lose the object in each trial, without a simulation and without figures."""
    lost = LiftOutcome("missed", True, 30.0, math.nan, math.nan, 0.5)  # noqa: FBT003

    def lift(_: Any, setups: list[Any]) -> list[tuple[None, LiftOutcome]]:  # noqa: ANN401
        return [(None, lost)] * len(setups)

    monkeypatch.setattr(lift_trial, "lift", lift)
    hide_packages("matplotlib")


def test_a_lift_is_printed_as_tables_and_written_as_a_report(lifted: tuple[str, Path]) -> None:
    text, folder = lifted
    assert "| psd, none " in text
    assert "| psd, steps " in text
    assert re.search(r"\| paper, real objects \| +35 \| +35\.0 \|", text)
    assert {path.suffix for path in folder.iterdir()} >= {".html", ".md", ".json"}
    if importlib.util.find_spec("matplotlib"):
        assert "least that holds" in (folder / "lift.svg").read_text()
    again = "experiment lift --trials 1 --method psd --rule none --rule steps --object ball --seed 0\n"
    assert again in (folder / "lift.md").read_text()


def test_unknown_values_are_null_in_json_and_a_dash_in_tables(lifted: tuple[str, Path]) -> None:
    _, folder = lifted
    found = json.loads((folder / "lift.json").read_text(), parse_constant=_no_constant)
    assert found["sections"]["lift"]["tables"][0]["rows"][0]["force"] is None
    page = (folder / "lift.md").read_text()
    assert "nan" not in page
    assert "psd, none holds, without a false slip, in 0 of 1 trials (0.0 %)" in page


def test_a_tap_is_printed_as_json(tmp_path: Path) -> None:
    found = json.loads(_output(tmp_path, "tap", *ONE, "--json").splitlines()[-1], parse_constant=_no_constant)
    assert found == json.loads((tmp_path / "tap.json").read_text())
    assert (found["experiment"], found["trials"], list(found["objects"])) == ("tap", 1, ["ball"])
    assert found["mean_success"] in (0, 100)
    assert found["rivals"]["psd"] == {name: found[name] for name in ("mean_success", "false_slip_firm")}
    assert "failures" in found


@pytest.mark.usefixtures("no_simulation")
@pytest.mark.parametrize(("method", "warned"), [("tcn", True), ("psd", False)])
def test_a_detector_that_is_not_for_grasps_is_noted(tmp_path: Path, method: str, *, warned: bool) -> None:
    options = "--trials", "1", "--object", "ball", "--method", method, "--out", str(tmp_path)
    note = "tcn is meant for strokes and misses slips of held objects; tcn_grasp is for grasps"
    assert (note in CliRunner().invoke(app, ["lift", *options]).stderr) == warned


@pytest.mark.usefixtures("no_simulation")
def test_the_log_states_what_figures_need(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["lift", *ONE, "--out", str(tmp_path)])
    assert "no figures, which need matplotlib: in the clone, pip install -e '.[report]'" in result.stderr
    assert not (tmp_path / "lift.svg").exists()


@pytest.mark.usefixtures("no_simulation")
def test_a_stress_test_is_printed_and_written(tmp_path: Path) -> None:
    text = _output(tmp_path, "lift", *ONE, "--rule", "none", "--stress")
    assert "Friction: psd, none breaks at x0.5, x0.75, x1, x1.5, x2" in text
    assert all(f"| {name} " in text for name in AXES)
    assert {path.name for path in tmp_path.iterdir()} >= {"lift-stress.html", "lift-stress.json"}
    page = (tmp_path / "lift-stress.md").read_text()
    assert "lift --trials 1 --method psd --rule none --object ball --stress" in page


@pytest.mark.usefixtures("no_simulation")
def test_without_a_method_ours_and_its_rivals_run_each_with_its_rule(tmp_path: Path) -> None:
    found = json.loads(_output(tmp_path, "lift", *ONE[2:], "--json").splitlines()[-1])
    methods = [row["method"] for row in found["sections"]["lift"]["tables"][0]["rows"]]
    assert methods == ["tcn_grasp, ours", "threshold, steps", "psd, steps", "paper, steps"]
    assert found["rivals"].keys() == {"threshold", "psd", "paper"}


def test_learning_without_the_train_extra_fails_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hide_packages: Callable[..., None]
) -> None:
    def simulated(*_: Any) -> None:  # noqa: ANN401
        raise AssertionError

    hide_packages("torch", "onnx")
    monkeypatch.setattr("flows.lab.experiments.grasp_training.grasp_recordings", simulated)
    result = CliRunner().invoke(app, ["learn", "-o", str(tmp_path)])
    assert isinstance(result.exception, InputError)
    assert "learn: needs onnx, torch: in the clone, pip install -e '.[train]'" in str(result.exception)

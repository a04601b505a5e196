"""`slipflow evaluate` as a user meets it."""

import json
from pathlib import Path

import pytest

from flows.cli import detectors as detector_commands
from flows.learn.training.learning_curve import Check
from flows.learn.training.recipe import Recipe
from flows.learn.training.trainer import train
from flows.report import figures
from storage.models import shipped
from tests.command import slipflow


def test_evaluate_prints_one_object_and_writes_page_and_tables(tiny: Path, tmp_path: Path) -> None:
    done = slipflow("evaluate", str(tiny), "--method", "psd", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert list(found["methods"]) == ["psd"]
    assert 50 < found["methods"]["psd"]["accuracy"] < 100
    assert "judging psd" in done.stderr
    names = {path.name for path in (tmp_path / "evaluation").iterdir()}
    assert {"evaluation.html", "evaluation.json", "evaluation.md", "evaluation-motions.svg"} < names
    markdown = (tmp_path / "evaluation" / "evaluation.md").read_text()
    assert markdown.endswith("    slipflow evaluate tiny --split test --method psd --budget 2\n")


def test_evaluate_prints_tables_for_a_person(tiny: Path, tmp_path: Path) -> None:
    done = slipflow("evaluate", str(tiny), "--method", "psd", "--out", "here", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "| psd    |" in done.stdout
    assert "| rotation" in done.stdout
    assert (tmp_path / "here" / "evaluation.html").exists()


def test_mistakes_are_one_line_each(tiny: Path, tmp_path: Path) -> None:
    for arguments in (
        ("evaluate", "nowhere"),
        ("evaluate", str(tiny), "--split", "holdout"),
        ("evaluate", str(tiny), "--method", "oracle"),
        ("evaluate", str(tiny), "--model", "missing.safetensors"),
    ):
        done = slipflow(*arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.splitlines()[-1].startswith("error: ")
        assert "Traceback" not in done.stderr


def test_train_and_onnx_make_files_that_others_read(tiny: Path, tmp_path: Path) -> None:
    size = ("--filters", "4", "--steps", "20", "-o", "small.safetensors", "--curve", "curve.svg")
    done = slipflow("train", str(tiny), *size, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (model,) = json.loads(done.stdout.splitlines()[-1])["models"]
    assert model["recipe"]["steps"] == 20
    assert json.loads((tmp_path / "small.json").read_text())["sha256"] == model["sha256"]
    assert "% on validation" in done.stderr
    assert (tmp_path / "curve.svg").read_text().startswith("<?xml")
    done = slipflow("onnx", "small.safetensors", "small.onnx", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "small.onnx").stat().st_size > 1000


def test_models_that_are_given_are_judged_beside_the_methods_that_are_named(
    tiny: Path, tmp_path: Path
) -> None:
    model = str(shipped("tcn"))
    done = slipflow("evaluate", str(tiny), "--method", "psd", "--model", model, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout.splitlines()[-1])["methods"]) == {"psd", "tcn_2"}


def test_only_a_tcn_can_be_exported_and_only_to_where_a_file_can_be(tmp_path: Path) -> None:
    done = slipflow("onnx", "psd", "psd.onnx", cwd=tmp_path)
    assert (done.returncode, "is no tcn" in done.stderr) == (2, True)
    done = slipflow("onnx", "tcn", "nowhere/tcn.onnx", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "nowhere/tcn.onnx" in done.stderr


def test_training_that_goes_on_says_so(tiny: Path, tmp_path: Path) -> None:
    def stop(_part: str, done: int, _of: int, _check: Check | None) -> None:
        if done == 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train([tiny], tmp_path / "m.safetensors", recipe=Recipe(filters=4, steps=20), progress=stop)
    command = ("train", str(tiny), "--filters", "4", "--steps", "20", "-o", "m.safetensors")
    done = slipflow(*command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "seed 0: goes on after step 10 of 20, where it was stopped" in done.stderr
    assert "goes on" not in slipflow(*command, cwd=tmp_path).stderr


@pytest.mark.parametrize("lag", ["-20ms", "2s"])
def test_labels_cannot_come_before_the_signal_or_much_after(tiny: Path, tmp_path: Path, lag: str) -> None:
    done = slipflow("train", str(tiny), "--lag", lag, cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert ("with its unit" if lag[0] == "-" else "from 0 to 0.6 s") in done.stderr


def test_evaluate_says_beforehand_that_it_cannot_draw(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def nothing(_: str) -> None:
        return None

    monkeypatch.setattr(figures, "find_spec", nothing)
    detector_commands.evaluate(tiny, method=["psd"], out=tmp_path / "out", as_json=True)
    assert (
        "the page will be without figures, which need matplotlib: in the clone, pip install -e '.[report]'"
        in capsys.readouterr().err
    )

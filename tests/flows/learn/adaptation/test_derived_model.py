import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from flows.cli.main import app
from flows.learn.adaptation import derived_model
from flows.learn.adaptation.derived_model import adapt_model, fine_tune_model
from flows.learn.labelled_recordings import LabelledRecording, load, load_unlabelled
from flows.learn.leaks.leak import SEEN
from flows.learn.training.trained_model import write_model
from operators.batch import UNKNOWN
from operators.detectors import Tcn
from operators.errors import InputError, ParameterError
from storage import load_detector
from storage.models import load_card
from tests.flows.learn.adaptation.conftest import Stroked

LONG = {"stroke": 1.2, "amplitude": 30.0}


@pytest.fixture
def parent(learned: Tcn, tmp_path: Path) -> Path:
    card = {"detector": "tcn", "fingertip": learned.fingertip.describe(), "target": "arm-speed"}
    return write_model(tmp_path / "parent.safetensors", learned.weights, card, ()).path


@pytest.fixture
def recorded(strokes: Stroked, monkeypatch: pytest.MonkeyPatch) -> list[LabelledRecording]:
    """Recordings that every path has."""
    found = [replace(strokes(seed, **LONG), split="train") for seed in (10, 11)]

    def reading(*_: object, **__: object) -> list[LabelledRecording]:
        return found

    for name in ("load", "load_unlabelled"):
        monkeypatch.setattr(derived_model, name, reading)
    return found


def test_the_card_of_an_adapted_model_states_its_origin(
    parent: Path, recorded: list[LabelledRecording], tmp_path: Path
) -> None:
    out = tmp_path / "adapted.safetensors"
    derived = adapt_model(str(parent), [tmp_path], out, first=25.0)
    card = load_card(out)
    assert card["parent"] == {"id": "parent", "sha256": hashlib.sha256(parent.read_bytes()).hexdigest()}
    assert card["adaptation"]["method"] == "adapt"
    assert [each["seconds"] for each in card["adaptation"]["recordings"]] == [25.0, 25.0]
    assert card["scores"]["held_out"]["after"] > card["scores"]["held_out"]["before"]
    assert card["target"] == "arm-speed"
    assert [name for name, _ in card[SEEN]["train"]["recordings"]] == [each.name for each in recorded]
    assert isinstance(load_detector(out), Tcn)
    assert str(out) in derived.report()
    assert derived.summary()["better"] is True


@pytest.mark.usefixtures("recorded")
def test_fine_tuning_on_two_recordings_improves_and_states_its_origin(parent: Path, tmp_path: Path) -> None:
    out = tmp_path / "tuned.safetensors"
    done = list[tuple[int, int]]()

    def progress(count: int, of: int) -> None:
        done.append((count, of))

    fine_tune_model(str(parent), [tmp_path], out, steps=30, progress=progress, keep_new=True)
    card = load_card(out)
    assert card["adaptation"]["method"] == "train --from"
    assert card["scores"]["held_out"]["after"] > card["scores"]["held_out"]["before"]
    assert set(card["debounce"]) == {"threshold", "consecutive", "release"}
    assert done[-1] == (30, 30)


def test_a_model_that_is_not_better_is_not_written_unless_asked_for(
    parent: Path, recorded: list[LabelledRecording], tmp_path: Path
) -> None:
    right = adapt_model(str(parent), [tmp_path], tmp_path / "right.safetensors").model
    assert right is not None
    wrong, truth = recorded
    recorded[:] = [replace(wrong, label=1 - wrong.label), replace(truth, split="test")]
    out = tmp_path / "worse.safetensors"
    kept = fine_tune_model(str(right.path), [tmp_path], out, steps=60)
    assert kept.model is None
    assert not out.exists()
    assert kept.report().startswith(f"kept {right.path}: the new model is not better")
    forced = fine_tune_model(str(right.path), [tmp_path], out, steps=60, keep_new=True)
    assert out.exists()
    assert "NOT better than its parent" in forced.report()


def test_recordings_of_one_class_cannot_be_learned_from(
    parent: Path, recorded: list[LabelledRecording], tmp_path: Path
) -> None:
    recorded[:] = [replace(each, label=np.zeros_like(each.label)) for each in recorded]
    with pytest.raises(InputError, match="lacks slip or static samples to learn from"):
        fine_tune_model(str(parent), [tmp_path], tmp_path / "m.safetensors")


def test_only_a_tcn_is_adapted_and_the_output_is_checked_first(parent: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="psd: is not a tcn: only a tcn can be adapted"):
        adapt_model("psd", [tmp_path], tmp_path / "m.safetensors")
    with pytest.raises(ParameterError, match=r"ends in \.safetensors"):
        adapt_model(str(parent), [tmp_path], tmp_path / "m.pt")


def test_touch_is_read_without_labels(tiny: Path) -> None:
    labelled, plain = load(tiny), load_unlabelled(tiny)
    assert [each.name for each in plain] == [each.name for each in labelled]
    assert all((each.label == UNKNOWN).all() for each in plain)
    np.testing.assert_array_equal(plain[0].counts, labelled[0].counts)
    [alone] = load_unlabelled(tiny / "sessions" / plain[0].name)
    assert alone.fingertip == plain[0].fingertip
    with pytest.raises(InputError, match="there is no such folder"):
        load_unlabelled(tiny / "nothing")


@pytest.mark.usefixtures("recorded")
def test_the_command_writes_the_model_or_exits_3(
    parent: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = CliRunner().invoke(app, ["adapt", str(parent), "--to", "lab"])
    assert (found.exit_code, "wrote adapted.safetensors" in found.output) == (0, True)
    again = CliRunner().invoke(app, ["adapt", "adapted.safetensors", "--to", "lab", "-o", "b.safetensors"])
    assert again.exit_code in {0, 3}
    assert (tmp_path / "b.safetensors").exists() is (again.exit_code == 0)

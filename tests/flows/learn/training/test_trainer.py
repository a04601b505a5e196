import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording, by_split, load
from flows.learn.training import dense_training
from flows.learn.training.dense_training import train_dense
from flows.learn.training.recipe import PaperRecipe, Recipe
from flows.learn.training.trained_model import learned, repeated
from flows.learn.training.trainer import train
from operators.detectors import PaperTcn, Tcn
from operators.errors import InputError, ParameterError
from storage import load_detector
from tests.flows.learn.conftest import Trained
from tests.flows.learn.training.conftest import TrainOn

SMALL = Recipe(filters=4, units=4, steps=6, batch=8, checks=3, rate=2e-2)


def test_a_model_and_its_card_say_where_they_come_from(small: Trained) -> None:
    model, reported = small
    out = model.path
    card = json.loads(out.with_suffix(".json").read_text())
    assert card["sha256"] == hashlib.sha256(out.read_bytes()).hexdigest()
    assert (card["detector"], card["seed"]) == ("tcn", 0)
    assert card["data"][0]["recordings"]["train"] > card["data"][0]["recordings"]["test"]
    assert card["recipe"]["filters"] == 4
    assert card["scores"]["test"]["accuracy"] > 55
    assert [each[0] for each in reported] == list(range(1, 61))
    assert sum(each[2] is not None for each in reported) == len(card["curve"]) == 3
    assert model.report().startswith(f"wrote {out} and its card\nvalidation: accuracy ")
    assert isinstance(load_detector(out), Tcn)
    assert sorted(path.name for path in out.parent.iterdir()) == ["small.json", "small.safetensors"]


def test_a_network_of_the_paper_is_trained_by_its_recipe(tiny: Path, train_on: TrainOn) -> None:
    few = [found[0] for found in by_split(load(tiny)).values()]
    model = train_on(few, PaperRecipe("paper_tcn", epochs=1))
    assert isinstance(load_detector(model.path), PaperTcn)
    assert model.card["recipe"]["batch"] == 256
    assert len(model.card["curve"]) == 1


def test_a_few_recordings_are_divided_in_time_but_not_those_of_the_test_split(
    tiny: Path, train_on: TrainOn, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = list[LabelledRecording]()

    def spied(learned: Any, validation: Any, *rest: Any) -> Any:
        used.extend([*learned, *validation])
        return train_dense(learned, validation, *rest)

    monkeypatch.setattr(dense_training, "train_dense", spied)
    few = [
        replace(each, split=split)
        for each, split in zip(load(tiny), ("train", "train", "test"), strict=False)
    ]
    few += [replace(each, counts=-each.counts) for each in few]  # of a second fingertip
    model = train_on(few, SMALL)
    assert {each.name for each in used} == {each.name for each in few[:2]} != {few[2].name}
    assert learned(model.card, few) == [each for each in few if each.split == "train"]


def test_a_recording_in_two_splits_is_refused(train_on: TrainOn) -> None:
    counts = np.arange(54, dtype=np.int16).reshape(9, 6)
    one = LabelledRecording(counts, np.zeros(9, np.int8), name="one", split="train")
    untouched = [replace(one, counts=0 * counts, split=split) for split in ("train", "test")]
    assert not repeated(untouched, ["train", "test"])  # all of one length are equal
    with pytest.raises(InputError, match=r"copy \(test\) is the same recording as one \(train\): give each"):
        train_on([one, replace(one, name="copy", split="test")], SMALL)


def test_another_format_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"ends in \.safetensors"):
        train([tmp_path / "nothing"], tmp_path / "model.pt", SMALL)


def test_a_model_is_written_also_if_what_is_held_out_has_no_slip(tiny: Path, train_on: TrainOn) -> None:
    first, *_, last = load(tiny)
    still = replace(last, label=np.zeros_like(last.label), split="validation")
    model = train_on([replace(first, split="train"), still], SMALL)
    assert model.card["curve"][-1]["balanced"] is None
    assert "validation: accuracy" in model.report()
    again = train_on([first, replace(still, split="test")], SMALL, start="tcn")
    assert "after: accuracy" in again.report()


@pytest.mark.parametrize("split", ["validation", "test"])
def test_a_split_without_labels_after_the_warm_up_is_refused(
    tiny: Path, train_on: TrainOn, split: str
) -> None:
    found = [parts[0] for parts in by_split(load(tiny)).values()]
    short = [each.piece(slice(0, 211)) if each.split == split else each for each in found]
    with pytest.raises(ParameterError, match=f"{split} recordings with labels after their warm-up of 2.11 s"):
        train_on(short, SMALL)

import json
from pathlib import Path

import pytest

from connectors.rig.paper import Collection
from flows.networks.recipe import Recipe
from operators import ParameterError
from operators.detectors import GraspTcn
from storage import load_debounce, load_detector

pytest.importorskip("torch")

TINY = Recipe(filters=4, units=4, steps=6, checks=2, batch=4, crop=300)
STROKES = Collection(surfaces=("plane",), speeds=(0.1,), repeats=3, rotations=0, rounds=1)


def test_what_is_learnt_is_written_with_its_card_and_loads_as_a_detector(tmp_path: Path) -> None:
    from flows.experiment.learning import learn  # noqa: PLC0415 - loads torch

    done: list[int] = []
    out = tmp_path / "model.safetensors"
    model = learn(
        out,
        grasps=40,
        strokes=STROKES,
        recipe=TINY,
        progress=lambda step, _of, _check: done.append(step),
    )
    assert done == list(range(1, 7))
    assert isinstance(load_detector(out), GraspTcn)
    assert load_debounce(out) is not None
    card = json.loads(out.with_suffix(".json").read_text())
    assert card["curve"] == model.card["curve"]
    assert card["detector"] == "tcn_grasp"
    assert set(card["scores"]) == {"grasps", "strokes", "varied strokes"}
    assert card["data"][0]["recordings"] == {"train": 32, "validation": 4, "test": 4}


def test_a_model_ends_in_safetensors(tmp_path: Path) -> None:
    from flows.experiment.learning import learn  # noqa: PLC0415 - loads torch

    with pytest.raises(ParameterError, match="out"):
        learn(tmp_path / "model.npz")

import inspect
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from connectors.sim.paper_plan import PaperPlan
from flows.cli.experiments import learn as command
from flows.lab.experiments import grasp_training as learning
from flows.lab.experiments.grasp_training import FADES, LASTS, floored_cells, hard_parts, lengthened
from flows.learn.training.recipe import Recipe
from operators import SLIP, STATIC, UNKNOWN, ParameterError
from operators.detectors import GraspTcn
from storage import load_debounce, load_detector
from storage.models import load_card, shipped

pytest.importorskip("torch")

TINY = Recipe(filters=4, units=4, steps=6, checks=2, batch=4, crop=300)
STROKES = PaperPlan(surfaces=("plane",), speeds=(0.1,), repeats=3, rotations=0, rounds=1)


def test_a_trained_model_has_a_card_and_loads_as_a_detector(tmp_path: Path) -> None:
    from flows.lab.experiments.grasp_training import learn  # noqa: PLC0415 - loads torch

    done: list[int] = []
    out = tmp_path / "model.safetensors"
    model = learn(
        out,
        grasps=20,
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
    assert card["data"][0]["recordings"] == {"train": 16, "validation": 2, "test": 2}


def test_a_model_ends_in_safetensors(tmp_path: Path) -> None:
    from flows.lab.experiments.grasp_training import learn  # noqa: PLC0415 - loads torch

    with pytest.raises(ParameterError, match="out"):
        learn(tmp_path / "model.npz")


def _slips(n: int, *spans: tuple[int, int]) -> "np.ndarray[tuple[int], np.dtype[np.int8]]":
    label = np.full(n, STATIC, np.int8)
    for first, end in spans:
        label[first:end] = SLIP
    return label


def test_a_short_slip_is_lengthened_and_followed_by_unknown_samples() -> None:
    label = lengthened(_slips(60, (10, 12)))
    assert np.flatnonzero(label == SLIP).tolist() == list(range(10, 10 + LASTS))
    assert np.flatnonzero(label == UNKNOWN).tolist() == list(range(10 + LASTS, 10 + LASTS + FADES))


def test_a_long_slip_is_unchanged() -> None:
    label = _slips(60, (10, 40))
    assert (lengthened(label) == label).all()


def test_the_next_slip_is_not_unknown() -> None:
    label = lengthened(_slips(60, (10, 12), (17, 40)))
    assert (label[17:40] == SLIP).all()


def test_a_slip_at_the_end_is_not_lengthened_beyond_the_recording() -> None:
    assert lengthened(_slips(20, (18, 20))).tolist() == _slips(20, (18, 20)).tolist()


def test_hard_parts_are_short_slips_and_the_second_after_a_slip() -> None:
    label = hard_parts(_slips(400, (50, 53), (200, 260)))
    assert (label == SLIP).nonzero()[0].tolist() == [50, 51, 52]
    assert (label[280:360] == STATIC).all()
    assert (label[260:280] == UNKNOWN).all()
    assert (label[360:] == UNKNOWN).all()


def test_a_floored_cell_stays_at_its_minimum_for_a_second_far_below_rest() -> None:
    counts = np.random.default_rng(0).integers(-60, -40, (300, 6)).astype(np.int16)
    assert floored_cells(counts) == 0
    counts[100:, :2] = -450
    assert floored_cells(counts) == 2
    counts[:, 5] = -3  # at rest
    assert floored_cells(counts) == 2


def test_the_defaults_are_those_of_the_shipped_model() -> None:
    defaults = {name: each.default for name, each in inspect.signature(command).parameters.items()}
    assert defaults["grasps"] == learning.GRASPS
    assert defaults["steps"] == learning.RECIPE.steps
    path = shipped("tcn_grasp")
    assert path is not None
    card = load_card(path)
    assert card["recipe"] == json.loads(json.dumps(asdict(learning.RECIPE)))
    assert card["data"][0]["seed"] == defaults["seed"]
    assert sum(card["data"][0]["recordings"].values()) == learning.GRASPS
    assert card["debounce"]["threshold"] == learning.THRESHOLD

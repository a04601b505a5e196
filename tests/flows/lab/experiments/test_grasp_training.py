import inspect
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from connectors.sim.paper_plan import PaperPlan
from flows.cli.experiments import learn as command
from flows.lab.experiments.grasp_training import (
    FADES,
    GRACE,
    LASTS,
    LONG,
    LONG_GRACE,
    ONSET,
    RESTLESS,
    SPAN,
    Course,
    delayed,
    hard_parts,
)
from flows.lab.experiments.rivals import CARDS
from flows.lab.experiments.tuning import THRESHOLDS
from flows.learn.training.recipe import PaperRecipe, Recipe
from operators import SLIP, STATIC, UNKNOWN
from operators.detectors import GraspTcn, PaperTcn
from storage import load_debounce, load_detector
from storage.models import load_card, shipped

pytest.importorskip("torch")

TINY = Recipe(filters=4, units=4, steps=6, checks=2, batch=4, crop=300)
STROKES = PaperPlan(surfaces=("plane",), speeds=(0.1,), repeats=3, rotations=0, rounds=1)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[int]]:
    """Folder of the models of a tiny course, and the training steps done."""
    from flows.lab.experiments.grasp_training import Course, learn  # noqa: PLC0415 - loads torch

    folder, done = tmp_path_factory.mktemp("models"), list[int]()
    course = Course(
        grasps=20, strokes=STROKES, recipe=TINY, paper=PaperRecipe(epochs=1, batch=2048), trials=3
    )
    learn(folder, course, jobs=1, progress=lambda step, _of, _check: done.append(step))
    return folder, done


def test_both_networks_have_a_card_and_load_as_detectors(trained: tuple[Path, list[int]]) -> None:
    folder, done = trained
    assert done[:6] == list(range(1, 7))
    for file, kind in (("tcn_grasp", GraspTcn), ("paper_grasp", PaperTcn)):
        path = folder / f"{file}.safetensors"
        assert isinstance(load_detector(path), kind)
        card = load_card(path)
        assert card["detector"] == kind.name
        assert set(card["scores"]) == {"grasps", "strokes"}
        assert card["data"][0]["recordings"] == {"train": 16, "validation": 2, "test": 2}


def test_each_method_has_a_tuned_threshold(trained: tuple[Path, list[int]]) -> None:
    folder, _ = trained
    for file in CARDS.values():
        path = folder / f"{file}.safetensors"
        debounce = load_debounce(path)
        assert debounce
        assert debounce.threshold == load_card(path)["tuning"]["threshold"]
        assert debounce.threshold in THRESHOLDS


def _slips(n: int, *spans: tuple[int, int]) -> "np.ndarray[tuple[int], np.dtype[np.int8]]":
    label = np.full(n, STATIC, np.int8)
    for first, end in spans:
        label[first:end] = SLIP
    return label


def test_a_short_slip_is_delayed_lengthened_and_followed_by_unknown_samples() -> None:
    label = delayed(_slips(60, (10, 12)))
    assert np.flatnonzero(label == SLIP).tolist() == list(range(10 + GRACE, 10 + LASTS))
    unknown = [*range(10, 10 + GRACE), *range(10 + LASTS, 10 + LASTS + FADES)]
    assert np.flatnonzero(label == UNKNOWN).tolist() == unknown


def test_a_long_slip_is_only_delayed_but_longer() -> None:
    label = _slips(60, (10, 10 + LONG))
    assert (delayed(label)[10 + LONG_GRACE :] == label[10 + LONG_GRACE :]).all()
    assert (delayed(label)[10 : 10 + LONG_GRACE] == UNKNOWN).all()


def test_the_next_slip_is_not_lost() -> None:
    label = delayed(_slips(60, (10, 12), (30, 50)))
    assert (label[30 + GRACE : 50] == SLIP).all()


def test_a_slip_at_the_end_is_not_lengthened_beyond_the_recording() -> None:
    assert (delayed(_slips(20, (9, 20)))[9 + GRACE :] == SLIP).all()


def test_hard_parts_are_static_samples_with_moving_cells_and_onsets_of_slip() -> None:
    label, counts = _slips(200, (100, 160)), np.zeros((200, 6), np.int16)
    counts[50:, 3] = RESTLESS + 1
    chosen = hard_parts(counts, label)
    assert np.flatnonzero(chosen == STATIC).tolist() == list(range(50, 50 + SPAN))
    assert np.flatnonzero(chosen == SLIP).tolist() == list(range(100, 100 + ONSET))


def test_the_defaults_are_those_of_the_shipped_model() -> None:
    defaults = {name: each.default for name, each in inspect.signature(command).parameters.items()}
    usual = Course()
    assert (defaults["grasps"], defaults["seed"]) == (usual.grasps, usual.seed)
    assert (defaults["steps"], defaults["epochs"]) == (usual.recipe.steps, usual.paper.epochs)
    path = shipped("tcn_grasp")
    assert path is not None
    card = load_card(path)
    recipe = json.loads(json.dumps(asdict(usual.recipe)))
    assert card["recipe"] == {name: value for name, value in recipe.items() if name in card["recipe"]}
    assert card["data"][0]["seed"] == defaults["seed"]
    assert sum(card["data"][0]["recordings"].values()) == usual.grasps

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training import trainer
from flows.learn.training.recipe import PaperRecipe, Recipe
from flows.learn.training.trained_model import Model
from tests.flows.learn.conftest import shaken

TrainOn: TypeAlias = Callable[..., Model]


@pytest.fixture(scope="session")
def recordings() -> list[LabelledRecording]:
    """Return recordings of slip and static in a random order, 0.5 s each."""
    orders = [np.random.default_rng(seed).permutation(np.arange(14) % 2) for seed in range(6)]
    return [shaken(seed, np.repeat(order, 50).astype(np.int8)) for seed, order in enumerate(orders)]


@pytest.fixture
def train_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TrainOn:
    """Return a function that trains on recordings in the place of a dataset."""

    def train(found: list[LabelledRecording], recipe: Recipe | PaperRecipe, **more: Any) -> Model:
        monkeypatch.setattr(trainer, "load", lambda _: found)
        return trainer.train([tmp_path], tmp_path / "model.safetensors", recipe, **more)

    return train

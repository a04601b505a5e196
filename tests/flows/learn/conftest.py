"""Labels, recordings, and a small trained network."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import Check, Model
from flows.learn.training.trainer import train
from operators import Debounce
from operators.batch import Codes

TWICE = Debounce(0.5, consecutive=2, release=2)


def label(samples: int, *runs: tuple[int, int]) -> Codes:
    """Slip from the first to before the second of each run."""
    result = np.zeros(samples, np.int8)
    for first, end in runs:
        result[first:end] = 1
    return result


def shaken(seed: int, codes: Codes, cells: int = 6, **about: Any) -> LabelledRecording:
    """Return a recording in which slip shakes every cell and static does not."""
    spread = np.where(codes == 1, 40.0, 1.0)[:, None]
    counts = np.random.default_rng(seed).normal(0, spread, (len(codes), cells)).round()
    return LabelledRecording(counts.astype(np.int16), codes, **about)


class Trained(NamedTuple):
    """A small network that has learned from the tiny dataset, and the progress that it reported."""

    model: Model
    progress: list[tuple[int, int, Check | None]]


@pytest.fixture(scope="session")
def small(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    progress = list[tuple[int, int, Check | None]]()
    recipe = Recipe(filters=4, units=4, steps=60, batch=8, checks=3, rate=2e-2)
    out = tmp_path_factory.mktemp("small") / "small.safetensors"
    model = train([tiny], out, recipe, progress=lambda *each: progress.append(each))
    return Trained(model, progress)

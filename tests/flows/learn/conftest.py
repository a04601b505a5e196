"""Weights of an untrained network, and a small trained one."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import Check, Model
from flows.learn.training.trainer import train
from operators import Debounce
from operators.batch import Codes
from operators.detectors.tcn import shapes

TWICE = Debounce(0.5, consecutive=2, release=2)


def label(samples: int, *runs: tuple[int, int]) -> Codes:
    """Slip from the first to before the second of each run."""
    result = np.zeros(samples, np.int8)
    for first, end in runs:
        result[first:end] = 1
    return result


@pytest.fixture(scope="session")
def unlearned() -> Callable[[int], dict[str, NDArray[Any]]]:
    """Return a function that draws the weights of a TCN with a number of filters."""

    def weights(filters: int) -> dict[str, NDArray[Any]]:
        random = np.random.default_rng(filters)
        drawn: dict[str, NDArray[Any]] = {
            name: random.normal(0, math.prod(shape[:-1]) ** -0.5, shape).astype(np.float32)
            for name, shape in shapes(8, filters, 24, 3).items()
        }
        return drawn | {
            "dilations": np.array([1, 2, 4]),
            "position_scale": np.array([8], np.float32),
            "step_scale": np.array([1.5], np.float32),
        }

    return weights


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

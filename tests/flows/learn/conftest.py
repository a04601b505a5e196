"""Weights of an untrained network."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.detectors.tcn import shapes


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

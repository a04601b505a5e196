from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from operators import InputError
from operators.detectors import TRAINED
from operators.detectors.weights import check_weights

SHAPES = {"kernel": (2, 3), "bias": (3,)}


@pytest.mark.parametrize(
    ("weights", "complaint"),
    [
        ({"bias": np.array([0, np.nan, 0])}, "bias is not finite"),
        ({"bias": np.array([0, np.inf, 0])}, "bias is not finite"),
    ],
)
def test_an_invalid_array_is_named(weights: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError, match=rf"^Net weights: {complaint}$"):
        check_weights("Net", {"kernel": np.ones((2, 3)), **weights}, SHAPES)


@pytest.mark.parametrize("make", TRAINED.values())
def test_a_detector_without_its_weights_says_so(make: Callable[[Any], object]) -> None:
    with pytest.raises(InputError, match="is missing"):
        make({})

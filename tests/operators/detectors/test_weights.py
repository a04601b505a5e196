from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from operators import InputError
from operators.detectors import TRAINED
from operators.detectors.weights import check_weights

SHAPES = {"kernel": (2, 3), "bias": (3,)}


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_invalid_array_is_named(value: float) -> None:
    with pytest.raises(InputError, match=r"^Net weights: bias is not finite$"):
        check_weights("Net", {"kernel": np.ones((2, 3)), "bias": np.array([0, value, 0])}, SHAPES)


@pytest.mark.parametrize("make", TRAINED.values())
def test_a_detector_without_its_weights_says_so(make: Callable[[Any], object]) -> None:
    with pytest.raises(InputError, match="is missing"):
        make({})

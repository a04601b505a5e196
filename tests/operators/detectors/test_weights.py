import numpy as np
import pytest

from operators import InputError
from operators.detectors.weights import check_weights

SHAPES = {"kernel": (2, 3), "bias": (3,)}


def test_valid_arrays_pass_and_further_ones_are_ignored() -> None:
    check_weights(
        "Net", {"kernel": np.ones((2, 3)), "bias": np.zeros(3, np.int64), "more": np.zeros(1)}, SHAPES
    )


def test_a_missing_array_is_named() -> None:
    with pytest.raises(InputError, match=r"^Net weights: bias is missing$"):
        check_weights("Net", {"kernel": np.ones((2, 3))}, SHAPES)


def test_an_array_of_another_shape_is_named() -> None:
    with pytest.raises(InputError, match=r"^Net weights: kernel has shape \(3, 2\), must be \(2, 3\)$"):
        check_weights("Net", {"kernel": np.ones((3, 2)), "bias": np.zeros(3)}, SHAPES)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_array_that_is_not_finite_is_named(value: float) -> None:
    with pytest.raises(InputError, match=r"^Net weights: bias is not finite$"):
        check_weights("Net", {"kernel": np.ones((2, 3)), "bias": np.array([0, value, 0])}, SHAPES)

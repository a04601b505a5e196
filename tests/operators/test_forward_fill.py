import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators.forward_fill import forward_fill


@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(0, 30))
def test_an_invalid_value_is_replaced_by_the_last_valid_one_of_its_column(seed: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    values, valid = rng.integers(0, 99, (rows, 3)), rng.random((rows, 3)) < 0.7
    last = rng.integers(0, 99, 3)
    found, expected = forward_fill(values, valid, last), last.copy()
    for row in range(rows):
        expected[valid[row]] = values[row, valid[row]]
        np.testing.assert_array_equal(found[row], expected)

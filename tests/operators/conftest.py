from collections.abc import Callable

import numpy as np
import pytest

from operators import Batch
from operators.batch import columns


@pytest.fixture(scope="session")
def same() -> Callable[[Batch, Batch], None]:
    """Return a check that two batches have the same rows, bit for bit; NaN equals NaN."""

    def check(found: Batch, expected: Batch) -> None:
        assert type(found.check()) is type(expected.check())
        assert len(found) == len(expected)
        assert found.finger == expected.finger or not len(found)
        for name in columns(type(found)):
            left, right = getattr(found, name), getattr(expected, name)
            np.testing.assert_array_equal(left, right, err_msg=name)
            if left.dtype.kind == "f":  # 0.0 and -0.0 are equal, but not the same
                known = ~np.isnan(left)
                np.testing.assert_array_equal(np.signbit(left)[known], np.signbit(right)[known], err_msg=name)

    return check

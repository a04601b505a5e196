"""Replacement of missing readings by the last valid one."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.batch import Flags

Scalar = TypeVar("Scalar", bound=np.generic)


def forward_fill(values: NDArray[Scalar], valid: Flags, last: NDArray[Scalar]) -> NDArray[Scalar]:
    """Replace each invalid value by the last valid one of its column.

    Args:
        values: (n, m)
        valid: (n, m)
        last: (m,) replacements before the first valid value

    >>> values, valid = np.array([[7], [0], [9]]), np.array([[True], [False], [True]])
    >>> forward_fill(values, valid, np.zeros(1, np.int64)).ravel()
    array([7, 7, 9])
    """
    if np.count_nonzero(valid) == valid.size:  # faster than valid.all() for few rows
        return values
    source = np.where(valid, np.arange(1, len(values) + 1)[:, None], 0)  # (n, m) 0: `last`
    np.maximum.accumulate(source, axis=0, out=source)
    return np.take_along_axis(np.concatenate((last[None], values)), source, axis=0)

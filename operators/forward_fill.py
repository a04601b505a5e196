"""Replacement of missing readings by the last valid one."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.batch import Flags

Scalar = TypeVar("Scalar", bound=np.generic)


def forward_fill(
    values: NDArray[Scalar], valid: Flags, last: NDArray[Scalar] | None = None
) -> NDArray[Scalar]:
    """Replace each invalid value by the last valid one of its column.

    Args:
        values: (n, m)
        valid: (n, m)
        last: (m,) replacements before the first valid value; None: 0

    >>> values, valid = np.array([[7], [0], [9]]), np.array([[True], [False], [True]])
    >>> forward_fill(values, valid).ravel()
    array([7, 7, 9])
    """
    if b"\0" not in valid.tobytes():  # all are valid; five times as fast as numpy for one row
        return values
    source = np.where(valid, np.arange(1, len(values) + 1)[:, None], 0)  # (n, m) 0: `last`
    np.maximum.accumulate(source, axis=0, out=source)
    first = np.zeros_like(values[:1]) if last is None else last[None]
    return np.take_along_axis(np.concatenate((first, values)), source, axis=0)

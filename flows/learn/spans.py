"""Runs of samples of which the same holds, such as slips."""

import numpy as np
from numpy.typing import NDArray

from operators.batch import Flags


def runs(flags: Flags) -> NDArray[np.intp]:
    """The first sample of each run of True among flags (n,), and the first sample after it; (k, 2).

    >>> runs(np.array([True, False, True, True])).tolist()
    [[0, 1], [2, 4]]
    """
    turns = np.diff(np.concatenate(([0], flags, [0])).astype(np.int8))
    return np.flatnonzero(turns).reshape(-1, 2)

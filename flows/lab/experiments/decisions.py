"""What a detector's scores come to: when a slip is registered, and when it is over."""

import numpy as np

from flows.lab.experiments.trial import Trace
from operators.batch import Flags, Reals


def slipping(probability: Reals, threshold: float, consecutive: int) -> Flags:
    """Where a slip is registered: the last `consecutive` decisions of (n,) said so; NaN says nothing.

    >>> slipping(np.array([0.1, 0.9, 0.9, 0.2, 0.9]), 0.5, 2)
    array([False, False,  True, False, False])
    """
    slip = (probability >= threshold).astype(np.intp)
    run: Flags = np.convolve(slip, np.ones(consecutive, np.intp))[: len(slip)] >= consecutive
    return run


def registered(trace: Trace, threshold: float, consecutive: int) -> Reals:
    """When slips were registered (s), each at its first time."""
    now = slipping(trace.probability, threshold, consecutive)
    return trace.t[now & ~np.concatenate(([False], now[:-1]))]

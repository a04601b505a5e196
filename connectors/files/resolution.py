"""Resolution of stored counts: readings in any unit become whole numbers of 16 bits."""

from collections.abc import Iterator
from math import floor, log10
from typing import Final

import numpy as np

from operators.batch import Reals

COUNT_LIMIT: Final = 32767  # largest absolute count

_MANTISSAS: Final = ("1", "2", "2.5", "5")
_TOLERANCE: Final = 0.01  # of a step: float32 has 24 bits
_FINEST: Final = 1e-12
_PRECISION: Final = 1e-10  # of the largest reading: float64 has 53 bits


def resolution_of(values: Reals, *, offset: bool) -> float:
    """Return the step of readings, 1, 2, 2.5 or 5 times a power of ten.

    It is the largest of which all readings are multiples or, if 16 bits do not suffice for it, the smallest
    with which they fit.

    Args:
        values: (n, cells) readings; NaN is missing.
        offset: Each cell may have an offset; False for readings relative to the unloaded fingertip.

    >>> resolution_of(np.array([[101.32], [99.5]]), offset=True)
    0.02
    """
    lowest, highest = np.nanmin(values, axis=0), np.nanmax(values, axis=0)  # (cells,)
    largest, span = float(np.nanmax(np.abs(values))), float(np.max(highest / 2 - lowest / 2))
    plain = at_least(largest / COUNT_LIMIT)
    centred = at_least(max(span / (COUNT_LIMIT - 1), largest * _PRECISION))
    fits = min(plain, centred) if offset else plain
    exact = (step for step in _downwards(max(1.0, plain)) if is_multiple(values, step) or step < fits)
    found = next(exact)
    if found >= fits:
        return found
    return centred if offset and centred < plain / 2 else plain


def offsets(values: Reals, resolution: float) -> Reals:
    """Return the offset of each cell (cells,) in counts: 0, if the readings (n, cells) fit without."""
    lowest, highest = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    middle: Reals = np.rint((highest / 2 + lowest / 2) / resolution)
    fits = max(np.max(highest), -np.min(lowest)) / resolution <= COUNT_LIMIT + 0.5
    return np.zeros_like(middle) if fits else middle


def at_least(step: float) -> float:
    """Return the smallest of 1, 2, 2.5 or 5 times a power of ten that is not below `step`.

    >>> at_least(1.37), at_least(0.00003), at_least(0)
    (2.0, 5e-05, 1e-12)
    """
    step = max(step, _FINEST)
    power = floor(log10(step))
    usual = (float(f"{each}e{exponent}") for exponent in range(power - 1, power + 2) for each in _MANTISSAS)
    return next(each for each in usual if each >= step * (1 - 1e-9))


def is_multiple(values: Reals, step: float) -> bool:
    """Return True if all readings are multiples of a step; NaN is missing."""
    for part in (values[:1000], values):  # most other steps fail early
        steps = part / step
        if np.any(np.abs(steps - np.rint(steps)) > _TOLERANCE):
            return False
    return True


def _downwards(step: float) -> Iterator[float]:
    """Yield the usual steps from `step` on, finer and finer."""
    power = floor(log10(step)) + 1
    for exponent in range(power, -14, -1):
        for each in reversed(_MANTISSAS):
            if (smaller := float(f"{each}e{exponent}")) <= step:
                yield smaller

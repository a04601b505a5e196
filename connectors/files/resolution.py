"""Resolution of stored counts: readings in any unit become whole numbers of 16 bits."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from math import floor, log10
from typing import Final

import numpy as np

from operators.batch import Reals

COUNT_LIMIT: Final = 32767  # largest absolute count

_MANTISSAS: Final = ("1", "2", "2.5", "5")
_TOLERANCE: Final = 0.01  # of a step: float32 has 24 bits
_FINEST: Final = 1e-12
_PRECISION: Final = 1e-10  # of the largest reading: float64 has 53 bits


@dataclass(frozen=True)
class Steps:
    """Resolutions that the readings of a recording need, in their unit.

    Args:
        exact: Largest usual step of which all readings are multiples; 0: none.
        plain: Smallest usual step with which all readings fit in 16 bits.
        centred: Smallest usual step with which they fit if each cell has an offset.
    """

    exact: float
    plain: float
    centred: float


def needed(values: Reals) -> Steps:
    """Return the steps that readings (n, cells) need; NaN is missing.

    >>> needed(np.array([[98270.25], [143262.5]]))
    Steps(exact=0.0, plain=5.0, centred=1.0)
    """
    lowest, highest = np.nanmin(values, axis=0), np.nanmax(values, axis=0)  # (cells,)
    largest, span = float(np.nanmax(np.abs(values))), float(np.max(highest / 2 - lowest / 2))
    plain = at_least(largest / COUNT_LIMIT)
    centred = at_least(max(span / (COUNT_LIMIT - 1), largest * _PRECISION))
    usual = takewhile(lambda step: step >= centred, _downwards(max(1.0, plain)))
    exact = next(
        (step for step in usual if _multiples(values[:1000], step) and _multiples(values, step)), 0.0
    )
    return Steps(exact, plain, centred)


def common(needs: Sequence[Steps], *, offset: bool) -> float:
    """Return the resolution for recordings that are to have the same one.

    Args:
        needs: Steps of each recording.
        offset: Cells may have an offset; False for counts relative to the unloaded fingertip.
    """
    exact = min(each.exact for each in needs)
    plain = max(each.plain for each in needs)
    centred = max(each.centred for each in needs)
    if exact >= plain or (offset and exact >= centred):
        return exact
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


def _downwards(step: float) -> Iterator[float]:
    """Yield the usual steps from `step` on."""
    power = floor(log10(step)) + 1
    for exponent in range(power, -13, -1):
        for each in reversed(_MANTISSAS):
            if (smaller := float(f"{each}e{exponent}")) <= step:
                yield smaller


def _multiples(values: Reals, step: float) -> bool:
    steps = values / step
    return bool(np.all(~(np.abs(steps - np.rint(steps)) > _TOLERANCE)))  # NaN: missing

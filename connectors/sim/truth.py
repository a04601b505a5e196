"""Slips in the ground truth of a simulation: for tests and summaries, never for a detector."""

from typing import Final

import numpy as np

from operators.batch import Truth
from operators.sliding_motion import SlidingMotion

SLIDING: Final = SlidingMotion.speed
STICK: Final = SlidingMotion.stick


def true_slips(truth: Truth) -> list[tuple[int, int]]:
    """Return onset and end (ns) of every slip; a stick phase up to `STICK` is part of a slip."""
    at = truth.time[truth.sliding > SLIDING]  # (k,)
    if not len(at):
        return []
    breaks = np.flatnonzero(np.diff(at) > STICK)
    starts, ends = at[np.r_[0, breaks + 1]], at[np.r_[breaks, -1]]
    return list(zip(starts.tolist(), ends.tolist(), strict=True))

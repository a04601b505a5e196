"""Matching the onsets that were raised with the slips that there were."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from operators.batch import Times, ms

BEFORE: Final = 50 * ms  # ns, how much too early an onset may be: labels are that uncertain (paper, Fig. 6)
AFTER: Final = 150 * ms  # ns, how long after its end a slip may still ring


@dataclass(frozen=True)
class Onsets:
    """Onsets, held against true slips."""

    delays: Times  # (caught,) ns from the start of each slip that was caught to its first onset
    missed: int  # slips without an onset
    false: int  # onsets without a slip


def match_onsets(
    onsets: Times, slips: Sequence[tuple[int, int]], *, before: int = BEFORE, after: int = AFTER
) -> Onsets:
    """Match each slip with the first onset from `before` its start to `after` its end.

    Args:
        onsets: (n,) times of raised onsets, ns, increasing.
        slips: start and end of each true slip, ns, increasing.
        before: how much too early an onset may be, ns.
        after: how long after its end a slip may still ring, ns.

    >>> match_onsets(np.array([30 * ms, 900 * ms]), [(0, 200 * ms), (400 * ms, 500 * ms)])
    Onsets(delays=array([30000000]), missed=1, false=1)
    """
    delays: list[int] = []
    explained = np.zeros(len(onsets), np.bool_)  # (n,)
    for start, end in slips:
        within = (onsets >= start - before) & (onsets <= end + after)  # (n,)
        if within.any():
            delays.append(int(onsets[within][0]) - start)
        explained |= within
    return Onsets(np.array(delays, np.int64), len(slips) - len(delays), int((~explained).sum()))

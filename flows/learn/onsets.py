"""Runs of slip samples, and the match of onsets with true slips."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import Flags, Times, ms

BEFORE: Final = 50 * ms  # ns that an onset may precede its slip: uncertainty of the labels (paper, Fig. 6)
AFTER: Final = 150 * ms  # ns after the end of a slip in which an onset still belongs to it


@dataclass(frozen=True)
class Onsets:
    """Onsets matched with true slips."""

    delays: Times  # (caught,) ns from the start of each detected slip to its first onset
    missed: int  # slips without an onset
    false: int  # onsets without a slip


def match_onsets(
    onsets: Times, slips: Times | Sequence[tuple[int, int]], *, before: int = BEFORE, after: int = AFTER
) -> Onsets:
    """Match each slip with the first onset from `before` its start to `after` its end.

    Args:
        onsets: (n,) times of onsets, ns, increasing.
        slips: (k, 2) start and end of each true slip, ns.
        before: Time that an onset may precede its slip, ns.
        after: Time after the end of a slip in which an onset still belongs to it, ns.

    >>> match_onsets(np.array([30 * ms, 900 * ms]), [(0, 200 * ms), (400 * ms, 500 * ms)])
    Onsets(delays=array([30000000]), missed=1, false=1)
    """
    starts, ends = np.asarray(slips, np.int64).reshape(-1, 2).T  # (k,) each
    first, past = onsets.searchsorted(starts - before), onsets.searchsorted(ends + after, "right")
    found = first < past
    nesting = np.zeros(len(onsets) + 1, np.int64)  # change of the number of slips that an onset belongs to
    np.add.at(nesting, first[found], 1)
    np.add.at(nesting, past[found], -1)
    false = int((nesting.cumsum()[:-1] == 0).sum())
    return Onsets(onsets[first[found]] - starts[found], int((~found).sum()), false)


def runs(flags: Flags) -> NDArray[np.intp]:
    """Return the first sample of each run of True in flags (n,), and the first one after it; (k, 2).

    >>> runs(np.array([True, False, True, True])).tolist()
    [[0, 1], [2, 4]]
    """
    edges = np.diff(np.concatenate(([0], flags, [0])).astype(np.int8))
    return np.flatnonzero(edges).reshape(-1, 2)

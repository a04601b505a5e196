"""Tuning the debounce of slip events: the least delay within a budget of false alarms."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.learn.evaluation.event_metrics import PERIOD, Slips
from flows.learn.evaluation.sample_metrics import percent
from flows.learn.labelled_recordings import WARM_UP
from flows.learn.onsets import AFTER, BEFORE
from operators import Debounce, s
from operators.batch import Flags, Reals

BUDGET: Final = 2.0  # false alarms per static minute
MISSED: Final = 2.0  # %, slips without an onset, at most
REPEATED: Final = 2.0  # %, of slips, onsets after the first, at most
THRESHOLDS: Final = tuple(np.round(1 / (1 + np.exp(-np.arange(-1.5, 6.1, 0.25))), 3).tolist())
CONSECUTIVE: Final = (1, 2, 3, 4, 5)  # decisions
RELEASE: Final = (1, 2, 3, 5, 8, 12)  # decisions


def tuned(
    probabilities: Sequence[Reals],
    slips: Sequence[Slips],
    budget: float = BUDGET,
    missed: float = MISSED,
    repeated: float = REPEATED,
) -> Debounce:
    """The settings that raise onsets soonest among those that keep within three limits.

    False alarms are few in some minutes of recordings, so as many are counted as chance may have spared: the
    upper one-sigma limit of a Poisson count, n + 1 + sqrt(n + 3/4) (Gehrels 1986). Where no setting keeps
    within all limits, the budget comes first, then the sum of what the others exceed.

    Args:
        probabilities: of each recording (n,), on the validation split
        slips: of each recording
        budget: false alarms per static minute, at most
        missed: slips without an onset, at most; %
        repeated: onsets of a slip after its first, at most; % of the slips
    """
    joined = Joined.of(probabilities, slips)
    best, settings = (np.inf, np.inf, np.inf), (0.5, 2, 2)
    for threshold in THRESHOLDS:
        slip = run_lengths(joined.probability >= threshold)
        static = run_lengths(joined.probability < threshold)
        for consecutive in CONSECUTIVE:
            for release in RELEASE:
                found = joined.judged(slip >= consecutive, static >= release)
                alarms = found.false + 1 + np.sqrt(found.false + 0.75)
                over = max(alarms - budget * joined.minutes, 0)
                cost = over, max(found.missed - missed, 0) + max(found.repeated - repeated, 0), found.delay
                if cost < best:
                    best, settings = cost, (threshold, consecutive, release)
    return Debounce(*settings)


@dataclass(frozen=True, slots=True)
class Found:
    """What some settings of the debounce come to."""

    false: int  # onsets
    missed: float  # %
    repeated: float  # %
    delay: float  # samples, mean


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Recordings one after the other, so that a setting is judged at once; (n,) samples in all.

    One sample without a score stands between them, so that no run goes on from one to the next.
    """

    probability: Reals  # (n,)
    first: NDArray[np.intp]  # (m,) of each recording
    early: NDArray[np.intp]  # (k,) the earliest sample whose onset answers each slip
    late: NDArray[np.intp]  # (k,) the last
    start: NDArray[np.intp]  # (k,) of the slips
    answer: Flags  # (n,) where an onset answers a slip
    excused: Flags  # (n,) where it is not false
    minutes: float  # of static

    @classmethod
    def of(cls, probabilities: Sequence[Reals], slips: Sequence[Slips]) -> Self:
        """Join the probabilities (n,) of recordings, and their slips."""
        sizes = [len(each) + 1 for each in probabilities]
        first = np.cumsum([0, *sizes])
        values = np.full(first[-1] + 1, np.nan)
        windows, starts = list[tuple[int, int]](), list[int]()
        answer, excused = np.zeros((2, len(values)), np.bool_)
        for at, probability, true in zip(first[:-1].tolist(), probabilities, slips, strict=True):
            values[at + WARM_UP : at + len(probability)] = probability[WARM_UP:]
            for begin, end in (*true.found, *true.excused):
                low = at + max(-(-(begin - BEFORE) // PERIOD), 0)
                high = at + min((end + AFTER) // PERIOD, len(probability) - 1)
                excused[low : high + 1] = True
                if (begin, end) in true.found:
                    answer[low : high + 1] = True
                    windows.append((low, high))
                    starts.append(at + begin // PERIOD)
        early, late = np.array(windows, np.intp).reshape(-1, 2).T
        minutes = sum(true.static for true in slips) / (60 * s)
        return cls(values, first[:-1], early, late, np.array(starts, np.intp), answer, excused, minutes)

    def judged(self, slip: Flags, static: Flags) -> Found:
        """What comes of slips that may begin where `slip` and end where `static`; (n,) each."""
        turn = np.where(slip, 1, np.where(static, -1, 0)).astype(np.int8)
        turn[self.first] = -1
        at = np.flatnonzero(turn)
        raised = at[1:][(turn[at[1:]] == 1) & (turn[at[:-1]] == -1)]  # (o,) onsets
        false = int((~self.excused[raised]).sum())
        place = raised.searchsorted(self.early)  # (k,)
        caught = place < raised.searchsorted(self.late, "right")
        number = int(caught.sum())
        if not number:
            return Found(false, 100.0, 0.0, np.inf)
        repeats = int(self.answer[raised].sum()) - number
        delay = raised[place[caught]] - self.start[caught]
        missed = percent(len(caught) - number, len(caught))
        return Found(false, missed, percent(repeats, len(caught)), float(delay.mean()))


def run_lengths(decided: Flags) -> NDArray[np.intp]:
    """How many True stand in a row up to each sample, and with it; (n,)."""
    number = np.arange(len(decided))
    length: NDArray[np.intp] = number - np.maximum.accumulate(np.where(decided, -1, number))
    return length

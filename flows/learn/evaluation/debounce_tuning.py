"""Tuning of the debounce: the least onset delay within a budget of false alarms."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.learn.evaluation.event_metrics import Slips
from flows.learn.evaluation.sample_metrics import percent
from flows.learn.labelled_recordings import PERIOD, WARM_UP, LabelledRecording
from flows.learn.onsets import AFTER, BEFORE
from flows.learn.scoring import probabilities
from operators import Debounce, s
from operators.batch import Flags, Reals
from operators.detectors import Detector

BUDGET: Final = 2.0  # false alarms per static minute
MISSED: Final = 2.0  # %, largest share of slips without an onset
REPEATED: Final = 2.0  # %, most onsets after the first of a slip, relative to the slips
THRESHOLDS: Final = tuple(np.round(1 / (1 + np.exp(-np.arange(-1.5, 6.1, 0.25))), 3).tolist())
CONSECUTIVE: Final = (1, 2, 3, 4, 5)  # decisions
RELEASE: Final = (1, 2, 3, 5, 8, 12)  # decisions


def tuned_on(recordings: Sequence[LabelledRecording], detector: Detector, budget: float = BUDGET) -> Debounce:
    """Tune the debounce of a detector on recordings; see `tuned`."""
    scores = [probabilities(detector, recording) for recording in recordings]
    return tuned(scores, [Slips.labelled(recording) for recording in recordings], budget)


def tuned(
    scores: Sequence[Reals],
    slips: Sequence[Slips],
    budget: float = BUDGET,
    missed: float = MISSED,
    repeated: float = REPEATED,
) -> Debounce:
    """Return the settings with the least onset delay among those that keep three limits.

    Recordings of some minutes contain few false alarms, so the upper one-sigma limit of a Poisson count is
    compared with the budget: n + 1 + sqrt(n + 3/4) (Gehrels 1986). If no setting keeps all limits, the excess
    over the budget is minimised first, then the sum of the other excesses.

    Args:
        scores: Probabilities of each recording (n,), on the validation split.
        slips: True slips of each recording.
        budget: Most false alarms per static minute.
        missed: Most slips without an onset, %.
        repeated: Most onsets of a slip after its first, % of the slips.
    """
    joined = JoinedRecordings.of(scores, slips)
    best, settings = (np.inf, np.inf, np.inf), (0.5, 2, 2)
    for threshold in THRESHOLDS:
        slip = run_lengths(joined.probability >= threshold)
        static = run_lengths(joined.probability < threshold)
        for consecutive in CONSECUTIVE:
            for release in RELEASE:
                found = joined.outcome(slip >= consecutive, static >= release)
                alarms = found.false + 1 + np.sqrt(found.false + 0.75)
                over = max(alarms - budget * joined.minutes, 0)
                cost = over, max(found.missed - missed, 0) + max(found.repeated - repeated, 0), found.delay
                if cost < best:
                    best, settings = cost, (threshold, consecutive, release)
    return Debounce(*settings)


@dataclass(frozen=True, slots=True)
class DebounceOutcome:
    """Slip events that result from one debounce setting."""

    false: int  # false alarms
    missed: float  # %
    repeated: float  # %
    delay: float  # samples, mean


@dataclass(frozen=True, slots=True, eq=False)
class JoinedRecordings:
    """Recordings joined to (n,) samples, so that a setting is evaluated on all at once.

    One sample without a score separates them, so that no run continues from one to the next.
    """

    probability: Reals  # (n,)
    first: NDArray[np.intp]  # (m,) first sample of each recording
    early: NDArray[np.intp]  # (k,) first sample at which an onset detects each slip
    late: NDArray[np.intp]  # (k,) last such sample
    start: NDArray[np.intp]  # (k,) first sample of each slip
    detects: Flags  # (n,) True where an onset detects a slip
    excused: Flags  # (n,) True where an onset is not false
    minutes: float  # static

    @classmethod
    def of(cls, scores: Sequence[Reals], slips: Sequence[Slips]) -> Self:
        """Join the probabilities (n,) of recordings, and their slips."""
        sizes = [len(each) + 1 for each in scores]
        first = np.cumsum([0, *sizes])
        values = np.full(first[-1] + 1, np.nan)
        spans, starts = list[tuple[int, int]](), list[int]()
        detects, excused = np.zeros((2, len(values)), np.bool_)
        for at, probability, true in zip(first[:-1].tolist(), scores, slips, strict=True):
            values[at + WARM_UP : at + len(probability)] = probability[WARM_UP:]
            for begin, end in (*true.found, *true.excused):
                low = at + max(-(-(begin - BEFORE) // PERIOD), 0)
                high = at + min((end + AFTER) // PERIOD, len(probability) - 1)
                excused[low : high + 1] = True
                if (begin, end) in true.found:
                    detects[low : high + 1] = True
                    spans.append((low, high))
                    starts.append(at + begin // PERIOD)
        early, late = np.array(spans, np.intp).reshape(-1, 2).T
        minutes = sum(true.static for true in slips) / (60 * s)
        return cls(values, first[:-1], early, late, np.array(starts, np.intp), detects, excused, minutes)

    def outcome(self, slip: Flags, static: Flags) -> DebounceOutcome:
        """Return the events if slips begin where `slip` is True and end where `static` is; (n,) each."""
        change = np.where(slip, 1, np.where(static, -1, 0)).astype(np.int8)
        change[self.first] = -1
        at = np.flatnonzero(change)
        raised = at[1:][(change[at[1:]] == 1) & (change[at[:-1]] == -1)]  # (o,) onsets
        false = int((~self.excused[raised]).sum())
        index = raised.searchsorted(self.early)  # (k,)
        detected = index < raised.searchsorted(self.late, "right")
        number = int(detected.sum())
        if not number:
            return DebounceOutcome(false, 100.0, 0.0, np.inf)
        repeats = int(self.detects[raised].sum()) - number
        delay = raised[index[detected]] - self.start[detected]
        missed = percent(len(detected) - number, len(detected))
        return DebounceOutcome(false, missed, percent(repeats, len(detected)), float(delay.mean()))


def run_lengths(decided: Flags) -> NDArray[np.intp]:
    """Return the number of consecutive True up to and including each sample; (n,)."""
    number = np.arange(len(decided))
    length: NDArray[np.intp] = number - np.maximum.accumulate(np.where(decided, -1, number))
    return length

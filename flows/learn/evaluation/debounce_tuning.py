"""Tuning of the debounce: the least onset delay within a budget of false alarms."""

from collections.abc import Sequence
from itertools import product
from typing import Final

import numpy as np

from flows.learn.evaluation.event_metrics import EventMetrics, Slips
from flows.learn.labelled_recordings import PERIOD, WARM_UP, LabelledRecording
from flows.learn.scoring import probabilities
from operators import Debounce
from operators.batch import Reals
from operators.detectors import Detector

BUDGET: Final = 2.0  # false alarms per static minute
MISSED: Final = 2.0  # %, largest share of slips without an onset
REPEATED: Final = 2.0  # %, most onsets after the first of a slip, relative to the slips
THRESHOLDS: Final = tuple(np.round(1 / (1 + np.exp(-np.arange(-1.5, 6.1, 0.25))), 3).tolist())
CONSECUTIVE: Final = (1, 2, 3, 4, 5)  # decisions
RELEASE: Final = (1, 2, 3, 5, 8, 12)  # decisions
_GAP: Final = np.append(np.zeros(max(RELEASE)), np.full(20, np.nan))  # samples between recordings


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
    probability, true = joined(scores, slips)
    best, chosen = (np.inf, np.inf, np.inf), Debounce()
    for rule in (Debounce(*each) for each in product(THRESHOLDS, CONSECUTIVE, RELEASE)):
        found = EventMetrics.of([probability], [true], rule)
        alarms = found.false_alarms + 1 + np.sqrt(found.false_alarms + 0.75)
        over, excess, delay = max(alarms - budget * found.minutes, 0), 100 - missed, np.inf
        if len(found.delays):
            excess = max(found.missed - missed, 0) + max(found.repeated - repeated, 0)
            delay = float(found.delays.mean())
        if (over, excess, delay) < best:
            best, chosen = (over, excess, delay), rule
    return chosen


def joined(scores: Sequence[Reals], slips: Sequence[Slips]) -> tuple[Reals, Slips]:
    """Join recordings into one, so that a setting is evaluated on all at once.

    Before each recording, static samples end any slip, and samples without a score separate the onsets.
    """
    values, found, tolerated = [np.empty(0)], [np.empty((0, 2), np.int64)], [np.empty((0, 2), np.int64)]
    at = 0  # ns, start of the recording
    for probability, true in zip(scores, slips, strict=True):
        at += len(_GAP) * PERIOD
        found.append(at + true.found)
        tolerated.append(at + true.tolerated)
        values += [_GAP, np.full(min(WARM_UP, len(probability)), np.nan), probability[WARM_UP:]]
        at += len(probability) * PERIOD
    static = sum(true.static for true in slips)
    return np.concatenate(values), Slips(np.concatenate(found), np.concatenate(tolerated), static)

"""Tuning of the debounce: the least onset delay within a budget of false alarms."""

from collections.abc import Sequence
from itertools import product
from typing import Any, Final

import numpy as np

from flows.learn.event_metrics import EventMetrics, Slips
from flows.learn.labelled_recordings import LabelledRecording
from operators import Debounce
from operators.batch import Reals
from operators.detectors import Detector

BUDGET: Final = 2.0  # false alarms per static minute
MISSED: Final = 2.0  # %, largest share of slips without an onset
REPEATED: Final = 2.0  # %, most onsets after the first of a slip, relative to the slips
THRESHOLDS: Final = tuple(np.round(1 / (1 + np.exp(-np.arange(-1.5, 6.1, 0.25))), 3).tolist())
CONSECUTIVE: Final = (1, 2, 3, 4, 5)  # decisions at 100 Hz
RELEASE: Final = (1, 2, 3, 5, 8, 12)  # decisions at 100 Hz
_MENU: Final = tuple(Debounce(*each) for each in product(THRESHOLDS, CONSECUTIVE, RELEASE))


def tuned_on(recordings: Sequence[LabelledRecording], detector: Detector) -> Debounce:
    """Tune the debounce of a detector on recordings; see `tuned`."""
    scores = [recording.probabilities(detector) for recording in recordings]
    return tuned(scores, [Slips.labelled(recording) for recording in recordings])


def debounce_settings(rule: Debounce) -> dict[str, Any]:
    """Return the settings of a debounce as a model's card states them."""
    return {name: getattr(rule, name) for name in ("threshold", "consecutive", "release")}


def tuned(scores: Sequence[Reals], slips: Sequence[Slips], budget: float = BUDGET) -> Debounce:
    """Return the settings with the least onset delay among those that keep three limits.

    Recordings of some minutes contain few false alarms, so the upper one-sigma limit of a Poisson count is
    compared with the budget: n + 1 + sqrt(n + 3/4) (Gehrels 1986). If no setting keeps all limits, the excess
    over the budget is minimised first, then the sum of the other excesses.

    Args:
        scores: Probabilities of each recording (n,), on the validation split.
        slips: True slips of each recording.
        budget: Most false alarms per static minute.
    """

    def cost(rule: Debounce) -> tuple[float, float, float]:
        found = EventMetrics.of(scores, slips, rule)
        alarms = found.false_alarms + 1 + np.sqrt(found.false_alarms + 0.75)
        over = max(alarms - budget * found.minutes, 0)
        if not len(found.delays):
            return over, 100 - MISSED, np.inf
        excess = max(found.missed - MISSED, 0) + max(found.repeated - REPEATED, 0)
        return over, excess, float(found.delays.mean())

    return min(map(slips[0].sampling.rule, _MENU), key=cost)

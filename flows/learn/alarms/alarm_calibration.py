"""Choice of debounce settings that keep a rate of false alarms with a stated confidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, starmap, takewhile
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flows.learn.alarms.alarm_limit import TooLittleDataError, alarm_limit
from flows.learn.event_metrics import EventMetrics, Slips
from flows.learn.labelled_recordings import LabelledRecording
from operators import Debounce
from operators.batch import Reals, ms

_STRICTEST: Final = 7.0  # logit of the highest threshold
_LOWEST: Final = -1.5  # logit of the lowest threshold
_STEP: Final = 0.25
_LONG_RUNS: Final = (50, 30, 20, 12, 8)  # decisions, at the highest threshold
_RUNS: Final = ((5.0, 5), (4.0, 3), (3.0, 2), (_LOWEST, 1))  # decisions from this logit on
_RELEASES: Final = ((1.0, 12), (0.0, 8), (_LOWEST, 5))  # the same
_MISSED: Final = 1000 * ms  # ns, delay that a missed slip counts as in the choice among settings that hold
_PIECES: Final = 10  # into which a single session is cut


def _path() -> tuple[Debounce, ...]:
    logits = np.arange(_STRICTEST, _LOWEST - _STEP / 2, -_STEP)
    thresholds = np.round(1 / (1 + np.exp(-logits)), 5).tolist()
    rules = [Debounce(thresholds[0], run, _RELEASES[0][1]) for run in _LONG_RUNS]
    for logit, threshold in zip(logits, thresholds, strict=True):
        run, release = (
            next(value for least, value in steps if logit >= least) for steps in (_RUNS, _RELEASES)
        )
        rules.append(Debounce(threshold, run, release))
    return tuple(rules)


PATH: Final = _path()  # at 100 Hz, from strict to sensitive; fixed before any data is seen


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Outcome of every setting of `PATH` on every session, or on each piece of a single one."""

    outcomes: Sequence[Sequence[EventMetrics]]  # [setting][session]
    rules: Sequence[Debounce] = PATH  # the settings at the rate of the recordings

    @property
    def alarms(self) -> NDArray[np.int64]:
        """False alarms (settings, sessions)."""
        return np.array([[each.false_alarms for each in row] for row in self.outcomes], np.int64)

    @property
    def minutes(self) -> Reals:
        """Static minutes of each session; (sessions,)."""
        return np.array([each.minutes for each in self.outcomes[0]])


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Setting that keeps a rate of false alarms."""

    rate: float  # false alarms per static minute
    confidence: float
    setting: int  # its place in `PATH`
    debounce: Debounce
    bound: float  # upper confidence limit of its rate, per static minute
    measured: EventMetrics  # on the calibration data


def try_settings(recordings: Sequence[LabelledRecording], probabilities: Sequence[Reals]) -> Trials:
    """Debounce the probabilities (n,) of recordings with every setting.

    The fingertips of one session are one recording: their alarms have common causes. A single session is cut
    into ten pieces.
    """
    pieces = _PIECES if len({each.name for each in recordings}) == 1 else 1
    parts = dict[tuple[str, int], tuple[list[Reals], list[Slips]]]()
    for recording, probability in zip(recordings, probabilities, strict=True):
        edges = np.linspace(0, len(recording), pieces + 1).astype(int).tolist()
        for number, rows in enumerate(starmap(slice, pairwise(edges))):
            values, slips = parts.setdefault((recording.name, number), ([], []))
            values.append(probability[rows])
            slips.append(Slips.labelled(recording.piece(rows)))
    rules = tuple(map(recordings[0].sampling.rule, PATH))
    return Trials([[EventMetrics.of(*part, rule) for part in parts.values()] for rule in rules], rules)


def calibrated(trials: Trials, rate: float, confidence: float) -> Calibrated:
    """Return the best setting whose rate of false alarms is at most `rate`, with a confidence.

    The hypotheses "this setting has a higher rate" are tested from the strictest setting to the most
    sensitive one, each at the full error probability, up to the first that is not rejected. The order is
    fixed beforehand, so the probability that any accepted setting exceeds the rate is at most
    1 - confidence: fixed-sequence testing, as in "Learn then Test" [1]. `alarm_limit` says what each test
    assumes.

    So any accepted setting may be chosen by its outcome on the same data: the one with the least mean delay,
    where a missed slip counts as one second; without slips the most sensitive one.

    Raises:
        TooLittleDataError: if not even the strictest setting is accepted.

    References:
        [1] Angelopoulos, Bates, Candes, Jordan and Lei, "Learn then Test: Calibrating Predictive Algorithms
        to Achieve Risk Control" (2021).
    """
    every, each_minutes = trials.alarms, trials.minutes
    minutes = float(each_minutes.sum())
    limits = (alarm_limit(alarms, each_minutes, confidence) for alarms in every)
    accepted = list(takewhile(lambda limit: limit <= rate * minutes, limits))
    if not accepted:
        needed = alarm_limit(every[0], each_minutes, confidence) / rate
        raise TooLittleDataError(rate, confidence, int(every[0].sum()), minutes, needed)
    found = [_sum(trials.outcomes[setting]) for setting in range(len(accepted))]
    best = min(range(len(found)), key=lambda setting: (_cost(found[setting]), -setting))
    return Calibrated(rate, confidence, best, trials.rules[best], accepted[best] / minutes, found[best])


def _cost(found: EventMetrics) -> float:
    """Return the mean delay, ms, to whole ms; 0 without slips."""
    missed = found.missed_slips * _MISSED / ms
    return round((float(found.delays.sum()) + missed) / found.slips) if found.slips else 0.0


def _sum(every: Sequence[EventMetrics]) -> EventMetrics:
    return EventMetrics(
        np.concatenate([np.empty(0), *(each.delays for each in every)]),
        sum(each.missed_slips for each in every),
        sum(each.false_alarms for each in every),
        sum(each.repeats for each in every),
        sum(each.minutes for each in every),
    )

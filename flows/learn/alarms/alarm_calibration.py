"""Choice of debounce settings that keep a rate of false alarms with a stated confidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, starmap, takewhile
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.learn.alarms.alarm_limit import TooLittleDataError, alarm_limit
from flows.learn.evaluation.event_metrics import EventMetrics, Slips
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
    """Outcome of every setting of `PATH` on every unit: a recording, or all of a session or of a surface."""

    alarms: NDArray[np.int64]  # (settings, n) false alarms in each unit
    minutes: Reals  # (n,) static minutes of each unit, of all its fingertips
    outcomes: tuple[tuple[EventMetrics, ...], ...]  # [setting][unit]
    rules: tuple[Debounce, ...] = PATH  # the settings at the rate of the recordings

    @classmethod
    def of(
        cls, recordings: Sequence[LabelledRecording], probabilities: Sequence[Reals], pieces: int = 1
    ) -> Self:
        """Debounce the probabilities (n,) of recordings with every setting.

        Args:
            recordings: Labelled recordings.
            probabilities: Probabilities of each.
            pieces: Number of consecutive pieces of equal length into which each recording is cut.
        """
        parts = list[tuple[Slips, Reals]]()
        for recording, probability in zip(recordings, probabilities, strict=True):
            edges = np.linspace(0, len(recording), pieces + 1).astype(int).tolist()
            for rows in starmap(slice, pairwise(edges)):
                parts.append((Slips.labelled(recording.piece(rows)), probability[rows]))
        rules = tuple(map(recordings[0].sampling.rule, PATH))
        outcomes = tuple(
            tuple(EventMetrics.of([values], [slips], rule) for slips, values in parts) for rule in rules
        )
        alarms = np.array([[each.false_alarms for each in own] for own in outcomes], np.int64)
        return cls(alarms, np.array([each.minutes for each in outcomes[0]]), outcomes, rules)

    def pooled(self, units: Sequence[object]) -> Self:
        """Return the outcomes with all recordings of a unit, such as a session or a surface, as one."""
        places = dict[object, list[int]]()
        for place, unit in enumerate(units):
            places.setdefault(unit, []).append(place)
        groups = list(places.values())
        return type(self)(
            np.stack([self.alarms[:, own].sum(axis=1) for own in groups], axis=1),
            np.array([self.minutes[own].sum() for own in groups]),
            tuple(tuple(_sum([row[place] for place in own]) for own in groups) for row in self.outcomes),
            self.rules,
        )

    def metrics(self, setting: int) -> EventMetrics:
        """Return the outcome of a setting on all units together."""
        return _sum(self.outcomes[setting])

    def drawn(self, units: Sequence[int]) -> Self:
        """Return the outcomes on some of the units."""
        outcomes = tuple(tuple(each[unit] for unit in units) for each in self.outcomes)
        return type(self)(self.alarms[:, [*units]], self.minutes[[*units]], outcomes, self.rules)


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Setting that keeps a rate of false alarms."""

    rate: float  # false alarms per static minute
    confidence: float
    setting: int  # its place in `PATH`
    debounce: Debounce
    bound: float  # upper confidence limit of its rate, per static minute
    measured: EventMetrics  # on the calibration data


def calibrated(trials: Trials, rate: float, confidence: float) -> Calibrated:
    """Return the best setting whose rate of false alarms is at most `rate`, with a confidence.

    The hypotheses "this setting has a higher rate" are tested from the strictest setting to the most
    sensitive one, each at the full error probability, up to the first that is not rejected. The order is
    fixed beforehand, so the probability that any accepted setting exceeds the rate is at most
    1 - confidence: fixed-sequence testing, as in "Learn then Test" [1]. Conformal risk control [2] would
    keep the rate on average over calibrations only, without a confidence. `alarm_limit` says what each test
    assumes.

    So any accepted setting may be chosen by its outcome on the same data: the one with the least mean delay,
    where a missed slip counts as one second; without slips the most sensitive one.

    Raises:
        TooLittleDataError: if not even the strictest setting is accepted.

    References:
        [1] Angelopoulos, Bates, Candes, Jordan and Lei, "Learn then Test: Calibrating Predictive Algorithms
        to Achieve Risk Control" (2021).
        [2] Angelopoulos, Bates, Fisch, Lei and Schuster, "Conformal Risk Control" (2022).
    """
    minutes = float(trials.minutes.sum())
    limits = (alarm_limit(alarms, trials.minutes, confidence) for alarms in trials.alarms)
    accepted = list(takewhile(lambda limit: limit <= rate * minutes, limits))
    if not accepted:
        needed = alarm_limit(trials.alarms[0], trials.minutes, confidence) / rate
        raise TooLittleDataError(rate, confidence, int(trials.alarms[0].sum()), minutes, needed)
    found = [trials.metrics(each) for each in range(len(accepted))]
    best = min(range(len(found)), key=lambda each: (_cost(found[each]), -each))
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

"""Choice of debounce settings that keep a rate of false alarms with a stated confidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, takewhile
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
PIECES: Final = 10  # into which a single session is cut


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


PATH: Final = _path()  # from strict to sensitive; fixed before any data is seen


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Outcome of every setting of `PATH` on every session."""

    alarms: NDArray[np.int64]  # (settings, n) false alarms in each session
    minutes: Reals  # (n,) static minutes of each session, of all its fingertips
    outcomes: tuple[tuple[EventMetrics, ...], ...]  # [setting][session]

    @classmethod
    def of(
        cls,
        recordings: Sequence[LabelledRecording],
        probabilities: Sequence[Reals],
        sessions: Sequence[object] | None = None,
    ) -> Self:
        """Debounce the probabilities (n,) of recordings with every setting.

        A single session is cut into `PIECES` equal pieces. The rate then holds in the conditions of that
        session only.

        Args:
            recordings: Labelled recordings, one per session and fingertip.
            probabilities: Probabilities of each.
            sessions: Session of each; None: each is a session.
        """
        parts = list(zip(recordings, probabilities, sessions or range(len(recordings)), strict=True))
        if len({session for _, _, session in parts}) == 1:
            parts = [piece for part in parts for piece in _cut(*part)]
        slips = [Slips.labelled(recording) for recording, _, _ in parts]
        places = dict[object, list[int]]()
        for place, (_, _, session) in enumerate(parts):
            places.setdefault(session, []).append(place)
        found = [
            ([parts[place][1] for place in own], [slips[place] for place in own]) for own in places.values()
        ]
        outcomes = tuple(
            tuple(EventMetrics.of(values, true, rule) for values, true in found) for rule in PATH
        )
        alarms = np.array([[each.false_alarms for each in own] for own in outcomes], np.int64)
        return cls(alarms, np.array([each.minutes for each in outcomes[0]]), outcomes)

    def metrics(self, setting: int) -> EventMetrics:
        """Return the outcome of a setting on all sessions together."""
        every = self.outcomes[setting]
        return EventMetrics(
            np.concatenate([np.empty(0), *(each.delays for each in every)]),
            sum(each.missed_slips for each in every),
            sum(each.false_alarms for each in every),
            sum(each.repeats for each in every),
            sum(each.minutes for each in every),
        )

    def drawn(self, sessions: Sequence[int]) -> Self:
        """Return the outcomes on some of the sessions."""
        outcomes = tuple(tuple(each[session] for session in sessions) for each in self.outcomes)
        return type(self)(self.alarms[:, [*sessions]], self.minutes[[*sessions]], outcomes)


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Setting that keeps a rate of false alarms."""

    rate: float  # false alarms per static minute
    confidence: float
    setting: int  # its place in `PATH`
    bound: float  # upper confidence limit of its rate, per static minute
    measured: EventMetrics  # on the calibration data

    @property
    def debounce(self) -> Debounce:
        """Debounce with this setting, in its initial state."""
        return PATH[self.setting].reset_copy()


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
    return Calibrated(rate, confidence, best, accepted[best] / minutes, found[best])


def _cost(found: EventMetrics) -> float:
    """Return the mean delay, ms, to whole ms; 0 without slips."""
    missed = found.missed_slips * _MISSED / ms
    return round((float(found.delays.sum()) + missed) / found.slips) if found.slips else 0.0


def _cut(
    recording: LabelledRecording, probability: Reals, session: object
) -> list[tuple[LabelledRecording, Reals, object]]:
    """Return consecutive pieces of a recording, each as a session of its own."""
    edges = np.linspace(0, len(recording), PIECES + 1).astype(int).tolist()
    return [
        (recording.piece(slice(first, last)), probability[first:last], (session, first))
        for first, last in pairwise(edges)
    ]

"""Metrics of slip events: false alarms, missed slips and onset delay."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.learn.evaluation.sample_metrics import percent
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.onsets import match_onsets, runs
from flows.learn.sampling import Sampling
from operators import Debounce, ms, s
from operators.batch import SLIP, UNKNOWN, Flags, Reals, Scores, Times

PAUSE: Final = 100 * ms  # ns; a slip continues through shorter static stretches of the label
BRIEF: Final = 50 * ms  # ns; uncertainty of the labels (paper, Fig. 6)
DECISION: Final = 0.5  # probability from which on a sample counts as slip


@dataclass(frozen=True, slots=True, eq=False)
class Slips:
    """True slips of a recording; ns from its first sample.

    Pauses shorter than `PAUSE` belong to the slip. Slips that are shorter than `BRIEF` or begin during the
    warm-up need not be detected. An onset in such a slip, or where there is no label, is not a false alarm.
    """

    found: Times  # (k, 2) start and end of each slip that must be detected
    tolerated: Times  # (j, 2) start and end of all stretches in which onsets are not false
    static: int  # ns outside of all these, after the warm-up
    sampling: Sampling

    @classmethod
    def labelled(cls, recording: LabelledRecording) -> Self:
        """Return the slips by the recording's label."""
        return cls.of(recording.slip, PAUSE, recording.sampling, recording.label == UNKNOWN)

    @classmethod
    def of(cls, slip: Flags, pause: int, sampling: Sampling, unknown: Flags | None = None) -> Self:
        """Return the slips of samples (n,); those that are `unknown` (n,) are neither slip nor static.

        Static stretches shorter than `pause` (ns) belong to the slip.

        >>> Slips.of(np.arange(300) // 50 == 3, PAUSE, Sampling()).found / ms
        array([[1500., 1990.]])
        """
        if unknown is None:
            unknown = np.zeros(len(slip), np.bool_)
        period, warm_up = sampling.period, sampling.warm_up
        shortest = sampling.samples(pause)  # static stretch that separates slips
        slips = bridged(slip, shortest)  # (m, 2)
        found = (np.diff(slips)[:, 0] >= sampling.samples(BRIEF) - 1) & (slips[:, 0] >= warm_up)  # (m,)
        tolerated = np.concatenate([slips, bridged(unknown)])
        static = int((~filled(slip, shortest) & ~unknown)[warm_up:].sum()) * period
        return cls(slips[found] * period, tolerated * period, static, sampling)


def bridged(flags: Flags, pause: int = 1) -> NDArray[np.intp]:
    """Return first and last sample of each run of True, runs closer than `pause` samples joined; (k, 2)."""
    starts, ends = runs(flags).T
    separate = starts[1:] - ends[:-1] >= pause
    return np.stack(
        [starts[np.append(True, separate)[: len(starts)]], ends[np.append(separate, True)[: len(ends)]] - 1],
        axis=1,
    )


def filled(flags: Flags, pause: int) -> Flags:
    """Return the flags (n,) with pauses shorter than `pause` samples filled."""
    steps = np.zeros(len(flags) + 1, np.int8)
    starts, ends = bridged(flags, pause).T
    steps[starts], steps[ends + 1] = 1, -1
    joined: Flags = np.cumsum(steps)[:-1] > 0
    return joined


@dataclass(frozen=True, slots=True, eq=False)
class EventMetrics:
    """Onsets of slip events, compared with the true slips.

    An onset from 50 ms before a slip to 150 ms after it detects the slip. Each slip needs an onset of its
    own: a slip that begins while the previous one is still reported is missed.
    """

    delays: Reals  # (detected,) ms from the start of each detected slip to its first onset
    missed_slips: int
    false_alarms: int
    repeats: int  # onsets of a slip after its first
    minutes: float  # static

    @classmethod
    def of(cls, probabilities: Sequence[Reals], slips: Sequence[Slips], debounce: Debounce) -> Self:
        """Debounce the probabilities (n,) of each recording and match the onsets with its slips."""
        found = [
            onsets(probability, debounce, true.sampling)
            for probability, true in zip(probabilities, slips, strict=True)
        ]
        return cls.of_onsets(found, slips)

    @classmethod
    def of_onsets(cls, found: Sequence[Times], slips: Sequence[Slips]) -> Self:
        """Match the onsets (k,) of each recording, ns, with its slips."""
        delays, missed, false, repeats = list[Times](), 0, 0, 0
        for raised, true in zip(found, slips, strict=True):
            matched = match_onsets(raised, true.found)
            delays.append(matched.delays)
            missed += matched.missed
            false += match_onsets(raised, true.tolerated).false
            repeats += len(raised) - matched.false - len(matched.delays)
        minutes = sum(true.static for true in slips) / (60 * s)
        return cls(np.concatenate([np.empty(0), *delays]) / ms, missed, false, repeats, minutes)

    @property
    def slips(self) -> int:
        """Number of slips that must be detected."""
        return len(self.delays) + self.missed_slips

    @property
    def missed(self) -> float:
        """Slips without an onset, %."""
        return percent(self.missed_slips, self.slips)

    @property
    def repeated(self) -> float:
        """Onsets of a slip after its first, % of the slips."""
        return percent(self.repeats, self.slips)

    @property
    def onset_ms(self) -> float:
        """Median onset delay, ms; NaN if no slip was detected."""
        return float(np.median(self.delays)) if len(self.delays) else float("nan")


def onsets(probability: Reals, debounce: Debounce, sampling: Sampling) -> Times:
    """Return the times at which `Debounce` reports an onset; (k,) ns from the first probability (n,)."""
    scores = Scores(sampling.times(len(probability)), probability)
    slips = debounce.reset_copy().push(scores[sampling.warm_up :])
    raised: Times = slips.time[slips.state == SLIP]
    return raised

"""Metrics of slip events (false alarms, missed slips, onset delay), and the debounce tuned for them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.learn.labelled_recordings import LabelledRecording, Sampling
from operators import Debounce, ms, s
from operators.batch import SLIP, UNKNOWN, Codes, Flags, Reals, Scores, Times
from operators.detectors import Detector

PAUSE: Final = 100 * ms  # ns; a slip continues through shorter static stretches of the label
BRIEF: Final = 50 * ms  # ns; uncertainty of the labels (paper, Fig. 6)
BEFORE: Final = BRIEF  # ns that an onset may precede its slip
AFTER: Final = 150 * ms  # ns after the end of a slip in which an onset still belongs to it
DECISION: Final = 0.5  # probability from which on a sample counts as slip
BUDGET: Final = 2.0  # false alarms per static minute
MISSED: Final = 2.0  # %, largest share of slips without an onset
REPEATED: Final = 2.0  # %, most onsets after the first of a slip, relative to the slips
THRESHOLDS: Final = tuple(np.round(1 / (1 + np.exp(-np.arange(-1.5, 6.1, 0.25))), 3).tolist())
CONSECUTIVE: Final = (1, 2, 3, 4, 5)  # decisions at 100 Hz
RELEASE: Final = (1, 2, 3, 5, 8, 12)  # decisions at 100 Hz
_MENU: Final = tuple(Debounce(*each) for each in product(THRESHOLDS, CONSECUTIVE, RELEASE))


@dataclass(frozen=True)
class Onsets:
    """Onsets matched with true slips."""

    delays: Times  # (caught,) ns from the start of each detected slip to its first onset
    missed: int  # slips without an onset
    false: int  # onsets without a slip


def match_onsets(onsets: Times, slips: Times | Sequence[tuple[int, int]], *, before: int = BEFORE) -> Onsets:
    """Match each slip with its first onset from `before` its start to 150 ms after its end.

    An onset detects one slip, the earliest that it may belong to.

    Args:
        onsets: (n,) times of onsets, ns, increasing.
        slips: (k, 2) start and end of each true slip, ns.
        before: Time that an onset may precede its slip, ns.

    >>> match_onsets(np.array([30 * ms, 900 * ms]), [(0, 200 * ms), (400 * ms, 500 * ms)])
    Onsets(delays=array([30000000]), missed=1, false=1)
    >>> match_onsets(np.array([370 * ms]), [(0, 300 * ms), (400 * ms, 500 * ms)])
    Onsets(delays=array([370000000]), missed=1, false=0)
    """
    starts, ends = np.asarray(slips, np.int64).reshape(-1, 2).T  # (k,) each
    first, past = onsets.searchsorted(starts - before), onsets.searchsorted(ends + AFTER, "right")
    found = first < past
    nesting = np.zeros(len(onsets) + 1, np.int64)  # change of the number of slips that an onset belongs to
    np.add.at(nesting, first[found], 1)
    np.add.at(nesting, past[found], -1)
    false = int((nesting.cumsum()[:-1] == 0).sum())
    free, delays = 0, list[int]()  # the onsets before `free` belong to earlier slips
    for begin, end, start in zip(first.tolist(), past.tolist(), starts.tolist(), strict=True):
        onset = max(begin, free)
        if onset < end:
            free = onset + 1
            delays.append(int(onsets[onset]) - start)
    return Onsets(np.array(delays, np.int64), len(starts) - len(delays), false)


def runs(flags: Flags) -> NDArray[np.intp]:
    """Return the first sample of each run of True in flags (n,), and the first one after it; (k, 2).

    >>> runs(np.array([True, False, True, True])).tolist()
    [[0, 1], [2, 4]]
    """
    edges = np.diff(np.concatenate(([0], flags, [0])).astype(np.int8))
    return np.flatnonzero(edges).reshape(-1, 2)


def with_lost(label: Codes, places: NDArray[np.int64], longest: int) -> Codes:
    """Return the label of every place from a label (n,) of samples at `places` (n,).

    Up to `longest` - 1 lost samples have the label of the samples before and after them if these agree. Other
    lost samples are unknown.

    >>> with_lost(np.array([0, 0, 1, 1], np.int8), np.array([0, 2, 4, 8]), 3).tolist()
    [0, 0, 0, -1, 1, -1, -1, -1, 1]
    """
    steps = np.diff(places, append=places[-1:] + 1)
    kept = (steps <= longest) & (label == np.roll(label, -1))
    found: Codes = np.repeat(np.where(kept, label, UNKNOWN).astype(label.dtype), steps)
    found[places] = label
    return found


@dataclass(frozen=True, slots=True, eq=False)
class TrueSlips:
    """True slips of a recording; ns from its first sample.

    Pauses shorter than `PAUSE` belong to the slip. Slips that are shorter than `BRIEF` or begin during the
    warm-up need not be detected. An onset in such a slip, or where there is no label, is not a false alarm.
    """

    found: Times  # (k, 2) start and end of each slip that must be detected
    tolerated: Times  # (j, 2) start and end of all stretches in which onsets are not false
    static: int  # ns outside of all these, after the warm-up
    judged: int  # ns after the warm-up
    places: NDArray[np.int64]  # (n,) of the samples among regular ones
    sampling: Sampling

    @classmethod
    def labelled(cls, recording: LabelledRecording) -> Self:
        """Return the slips by the recording's label."""
        sampling, places = recording.sampling, recording.places
        label = with_lost(recording.label, places, sampling.samples(PAUSE))
        warm_up = next(iter(places[sampling.warm_up :]), len(label))
        starts, ends = runs(label == SLIP).T  # (m,) each
        apart = starts[1:] - ends[:-1] >= sampling.samples(PAUSE)
        starts = starts[np.append(True, apart)[: len(starts)]]
        ends = ends[np.append(apart, True)[: len(ends)]]
        slips = np.stack([starts, ends], axis=1)
        before = label[places[np.maximum(np.searchsorted(places, starts) - 1, 0)]]  # (k,) of the last sample
        lost = (label[starts - 1] == UNKNOWN) & (before == SLIP)  # a slip continues after lost samples
        required = (ends - starts >= sampling.samples(BRIEF)) & (starts >= warm_up) & ~lost
        tolerated: Times = np.concatenate([slips, runs(label == UNKNOWN)])
        static = np.ones(len(label), np.bool_)
        for first, end in tolerated.tolist():
            static[first:end] = False
        period, last = sampling.period, [0, 1]  # a slip ends at its last sample
        return cls(
            (slips[required] - last) * period,
            (tolerated - last) * period,
            int(static[warm_up:].sum()) * period,
            (len(label) - warm_up) * period,
            places,
            sampling,
        )


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
    def of(cls, probabilities: Sequence[Reals], slips: Sequence[TrueSlips], debounce: Debounce) -> Self:
        """Debounce the probabilities (n,) of each recording and match the onsets with its slips."""
        pairs = zip(probabilities, slips, strict=True)
        return cls.of_onsets([onsets(each, debounce, true) for each, true in pairs], slips)

    @classmethod
    def of_onsets(cls, found: Sequence[Times], slips: Sequence[TrueSlips]) -> Self:
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
        """Slips without an onset, %; NaN without slips."""
        return 100 * self.missed_slips / self.slips if self.slips else float("nan")

    @property
    def repeated(self) -> float:
        """Onsets of a slip after its first, % of the slips; NaN without slips."""
        return 100 * self.repeats / self.slips if self.slips else float("nan")


def onsets(probability: Reals, debounce: Debounce, true: TrueSlips) -> Times:
    """Return the times at which `Debounce` reports an onset; (k,) ns from the first probability (n,)."""
    scores = Scores(true.places * true.sampling.period, probability)
    slips = debounce.reset_copy().push(scores[true.sampling.warm_up :])
    raised: Times = slips.time[slips.state == SLIP]
    return raised


def tuned_on(recordings: Sequence[LabelledRecording], detector: Detector) -> Debounce:
    """Tune the debounce of a detector on recordings; see `tuned`."""
    scores = [recording.probabilities(detector) for recording in recordings]
    return tuned(scores, [TrueSlips.labelled(recording) for recording in recordings])


def debounce_settings(rule: Debounce) -> dict[str, Any]:
    """Return the settings of a debounce as a model's card states them."""
    return {name: getattr(rule, name) for name in ("threshold", "consecutive", "release")}


def tuned(scores: Sequence[Reals], slips: Sequence[TrueSlips], budget: float = BUDGET) -> Debounce:
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

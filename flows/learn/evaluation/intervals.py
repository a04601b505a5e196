"""Intervals over recordings: how much a figure depends on which recordings were made.

Samples of a recording are alike, so recordings are drawn with replacement, not samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self, TypeAlias

import numpy as np

from flows.learn.evaluation.event_metrics import DECISION, EventMetrics, Slips, onsets
from flows.learn.evaluation.sample_metrics import BINS, Confusion, Reliability, Roc, distance
from flows.learn.labelled_recordings import LabelledRecording
from operators import Debounce
from operators.batch import UNKNOWN, Flags, Reals

DRAWS: Final = 1000
FAR: Final = 100  # ms
_LEAST: Final = 3  # recordings: fewer give no interval
_BINS: Final = 512  # of the probabilities, for the area under the curve
_TAILS: Final = (0.025, 0.975)

Drawn: TypeAlias = Reals  # (draws,) or (draws, ...)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Figure with its 95 % interval over recordings; NaN: unknown."""

    value: float
    low: float = np.nan
    high: float = np.nan

    @classmethod
    def of(cls, value: float, drawn: Drawn) -> Self:
        """Return the figure with the interval of its values in draws (draws,), some of which may be NaN."""
        known = drawn[np.isfinite(drawn)]
        return cls(value, *map(float, np.quantile(known, _TAILS))) if len(known) else cls(value)

    def interval(self, decimals: int = 1) -> str:
        """Return the interval as tables show it; empty if it is unknown.

        >>> Estimate(90.0, 88.04, 93.0).interval()
        '88.0 to 93.0'
        """
        known = np.isfinite(self.low) and np.isfinite(self.high)
        return f"{self.low:.{decimals}f} to {self.high:.{decimals}f}" if known else ""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Answers of a method on one recording, next to its labels."""

    probability: Reals  # (k,) of the judged samples
    slip: Flags  # (k,) their labels
    events: EventMetrics
    onsets: int  # reported events
    minutes: float  # of the recording
    far: Flags  # (k,) True 100 ms or more from any change of the label

    @classmethod
    def of(cls, recording: LabelledRecording, probability: Reals, debounce: Debounce) -> Self:
        """Return the answers of a method that gives each sample a probability (n,); NaN: no answer."""
        sampling = recording.sampling
        known = np.isfinite(probability) & (recording.label != UNKNOWN)
        known[: sampling.warm_up] = False
        raised = onsets(probability, debounce, sampling)
        events = EventMetrics.of_onsets([raised], [Slips.labelled(recording)])
        minutes = sampling.minutes(max(len(recording) - sampling.warm_up, 0))
        far: Flags = distance(recording.label, sampling)[known] >= FAR
        return cls(probability[known], recording.slip[known], events, len(raised), minutes, far)


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of a method over recordings."""

    balanced: Estimate  # balanced accuracy, %
    far: Estimate  # the same, 100 ms or more from any change of the label
    area: Estimate  # under the ROC curve, %
    calibration: Estimate  # expected calibration error of the probability, %
    events_per_min: Estimate  # reported events per minute of recording
    false_alarms_per_min: Estimate  # per static minute
    missed: Estimate  # slips without an event, %
    delay: Estimate  # median from the start of a slip to its event, ms


def figures(recordings: Sequence[Sequence[Judged]], draws: int = DRAWS, seed: int = 0) -> Figures:
    """Return the figures of a method with their intervals over recordings.

    Args:
        recordings: Answers on each recording; several if the method was fitted several times.
        draws: Number of draws of as many recordings, with replacement.
        seed: Random seed.
    """
    weights = _weights(len(recordings), draws, seed)
    every = [each for own in recordings for each in own]
    slip, probability = (
        np.concatenate([np.empty(0), *(getattr(each, name) for each in every)])
        for name in ("slip", "probability")
    )
    events = [
        (each.events.false_alarms, each.events.minutes, each.events.missed_slips, each.events.slips)
        for each in every
    ]
    owner = [n for n, own in enumerate(recordings) for _ in own]
    sums = np.zeros((len(recordings), 6))  # false, static minutes, missed, slips, onsets, minutes
    for n, each, counts in zip(owner, every, events, strict=True):
        sums[n] += (*counts, each.onsets, each.minutes)
    drawn, total = weights @ sums, sums.sum(axis=0)
    delays = [np.concatenate([np.empty(0), *(each.events.delays for each in own)]) for own in recordings]
    late = np.concatenate([np.empty(0), *delays])
    return Figures(
        balanced_accuracy([_confusion(own) for own in recordings], draws, seed),
        balanced_accuracy([_confusion(own, far=True) for own in recordings], draws, seed),
        Estimate.of(100 * Roc.of(probability, slip.astype(np.bool_)).area, 100 * _areas(recordings, weights)),
        _calibration(recordings, weights),
        Estimate.of(float(_ratio(total[4], total[5])), _ratio(drawn[:, 4], drawn[:, 5])),
        Estimate.of(float(_ratio(total[0], total[1])), _ratio(drawn[:, 0], drawn[:, 1])),
        Estimate.of(100 * float(_ratio(total[2], total[3])), 100 * _ratio(drawn[:, 2], drawn[:, 3])),
        Estimate.of(float(np.median(late)) if len(late) else np.nan, _medians(delays, weights)),
    )


def balanced_accuracy(confusions: Sequence[Confusion], draws: int = DRAWS, seed: int = 0) -> Estimate:
    """Return the balanced accuracy (%) over recordings with its interval.

    >>> recordings = [Confusion(np.array([[9, 1], [k, 10 - k]])) for k in (0, 1, 2)]
    >>> found = balanced_accuracy(recordings)
    >>> found.value, found.interval()
    (90.0, '85.0 to 95.0')
    """
    counts = np.array([each.counts for each in confusions]).reshape(-1, 4)
    drawn = (_weights(len(counts), draws, seed) @ counts).reshape(-1, 2, 2)
    recalls = _ratio(drawn[:, [0, 1], [0, 1]], drawn.sum(axis=2))
    return Estimate.of(Confusion(counts.sum(axis=0).reshape(2, 2)).balanced, 100 * recalls.mean(axis=1))


def _confusion(judged: Sequence[Judged], *, far: bool = False) -> Confusion:
    counts = np.zeros((2, 2))
    for each in judged:
        rows = each.far | (not far)
        counts += Confusion.of(each.probability[rows] >= DECISION, each.slip[rows]).counts
    return Confusion(counts)


def _weights(recordings: int, draws: int, seed: int) -> Reals:
    """Return how often each recording is drawn; (draws, recordings)."""
    if recordings < _LEAST:
        return np.empty((0, recordings))
    shares = np.full(recordings, 1 / recordings)
    return np.random.default_rng(seed).multinomial(recordings, shares, draws).astype(np.float64)


def _areas(recordings: Sequence[Sequence[Judged]], weights: Reals) -> Drawn:
    """Return the area under the ROC curve in each draw (draws,), from histograms of the probabilities."""
    pooled = np.concatenate([np.empty(0), *(each.probability for own in recordings for each in own)])
    if not len(pooled):
        return np.empty(0)
    edges = np.unique(np.quantile(pooled, np.linspace(0, 1, _BINS + 1)[1:-1]))
    counts = np.zeros((2, len(recordings), len(edges) + 1))
    for n, own in enumerate(recordings):
        for each in own:
            bins = edges.searchsorted(each.probability, "right")
            for truth in (0, 1):
                counts[truth, n] += np.bincount(bins[each.slip == truth], minlength=len(edges) + 1)
    static, slip = weights @ counts[0], weights @ counts[1]  # (draws, bins) each
    below = np.cumsum(static, axis=1) - static / 2  # equal probabilities count half
    return _ratio((slip * below).sum(axis=1), slip.sum(axis=1) * static.sum(axis=1))


def _calibration(recordings: Sequence[Sequence[Judged]], weights: Reals) -> Estimate:
    """Return the expected calibration error over recordings with its interval, %."""
    sums = np.zeros((len(recordings), BINS + 1))  # of probability minus slip in each bin; samples
    for n, own in enumerate(recordings):
        for each in own:
            found = Reliability.of(each.probability, each.slip)
            gaps = np.nan_to_num(found.number * (found.probability - found.slip))
            sums[n] += (*gaps, found.number.sum())

    def error(pooled: Reals) -> Drawn:
        return 100 * _ratio(np.abs(pooled[..., :BINS]).sum(axis=-1), pooled[..., BINS])

    return Estimate.of(float(error(sums.sum(axis=0))), error(weights @ sums))


def _medians(delays: Sequence[Reals], weights: Reals) -> Drawn:
    """Return the median of the delays (k,) of each recording in each draw; (draws,)."""
    owners = np.repeat(np.arange(len(delays)), [len(each) for each in delays])
    values = np.concatenate([np.empty(0), *delays])
    order = np.argsort(values)
    if not len(values):
        return np.empty(0)
    passed = np.cumsum(weights[:, owners[order]], axis=1)  # (draws, k)
    middle = (passed < passed[:, -1:] / 2).sum(axis=1)
    found: Drawn = np.where(passed[:, -1] > 0, values[order][np.minimum(middle, len(values) - 1)], np.nan)
    return found


def _ratio(part: Drawn, whole: Drawn) -> Drawn:
    """Return the quotient; NaN if the divisor is 0."""
    part, whole = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    found: Drawn = np.divide(
        part, whole, out=np.full(np.broadcast(part, whole).shape, np.nan), where=whole > 0
    )
    return found

"""Rest and strokes of a recording without labels, from the activity of its counts.

While a finger rests, its counts only drift and have noise; while it slides, friction shears the fingertip and
the counts change within tenths of a second. The activity is the standard deviation over 0.6 s of one weighted
sum of the cells, the one whose slow changes are largest relative to the noise of single steps. Otsu's
threshold separates its two states.
"""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from operators.batch import Counts, Flags, Reals

_SPIKE: Final = 0.05  # s, of the median filter that removes single outliers
_SPAN: Final = 0.6  # s, over which the activity is computed, centred
_CHANGE: Final = 0.2  # s, between the two samples of a slow change
_DELAY: Final = 0.1  # s, from a change of the activity to that of a causal detector's target
_QUIET: Final = 0.8  # share of the steps, the smallest ones, that count as noise
_FLOOR: Final = 0.1  # counts, smallest activity
_RIDGE: Final = 1e-3  # counts^2, added to the noise


@dataclass(frozen=True, slots=True, eq=False)
class Segmentation:
    """Rest and strokes of a recording.

    Activity and strokes are delayed by 0.1 s: a detector cannot know what follows, and the span of the
    activity begins before the stroke.
    """

    activity: Reals  # (n,) log counts
    stroke: Flags  # (n,)
    contrast: float  # mean log activity of strokes less that of rest

    def rows(self, start: int, stop: int) -> Self:
        """Return the samples from `start` to before `stop`; the contrast stays that of all."""
        return replace(self, activity=self.activity[start:stop], stroke=self.stroke[start:stop])


def segmented(counts: Counts, rate: float) -> Segmentation:
    """Separate rest and strokes in counts (n, cells) of one recording at `rate` (Hz)."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    if len(counts) <= 2 * _samples(_CHANGE, rate):
        return Segmentation(np.zeros(len(counts)), np.zeros(len(counts), np.bool_), 0.0)
    smooth = ndimage.median_filter(counts.astype(np.float64), (_samples(_SPIKE, rate) | 1, 1))
    signal = smooth @ _weights(smooth, _samples(_CHANGE, rate))  # (n,)
    span, delay = _samples(_SPAN, rate), _samples(_DELAY, rate)
    mean = ndimage.uniform_filter1d(signal, span)
    variance = ndimage.uniform_filter1d(np.square(signal - signal.mean()), span)
    variance -= np.square(mean - signal.mean())
    activity = np.log(np.maximum(variance, _FLOOR**2)) / 2
    activity = np.concatenate((np.full(min(delay, len(activity)), activity[0]), activity))[: len(activity)]
    stroke = activity > two_states(activity)[0]
    contrast = float(activity[stroke].mean() - activity[~stroke].mean()) if stroke.any() else 0.0
    return Segmentation(activity, stroke, contrast)


def two_states(values: Reals) -> tuple[float, float]:
    """Return Otsu's threshold between two states of values (n,), and the share of variance between them.

    The share is 0.64 for normally distributed values, 0.75 for uniform ones, and 1 for two values.

    >>> two_states(np.array([0.0, 0.0, 4.0, 4.0]))
    (0.0, 1.0)
    """
    ordered = np.sort(values)
    sums, below = ordered.cumsum(), np.arange(1, len(values))
    low, high = sums[:-1] / below, (sums[-1] - sums[:-1]) / (len(values) - below)
    between = below * (len(values) - below) * np.square(high - low) / len(values) ** 2
    best = int(between.argmax())
    return float(ordered[best]), float(between[best] / (ordered.var() or 1.0))


def _weights(counts: Reals, change: int) -> Reals:
    """Return the weights (cells,) of the sum with the largest ratio of slow changes to noise.

    The sum has noise of one count per step.
    """
    slow = counts[change:] - counts[:-change]
    steps = np.diff(counts, axis=0)
    size = np.abs(steps).max(axis=1)
    quiet = steps[size <= np.quantile(size, _QUIET)]
    noise = quiet.T @ quiet / len(quiet) + _RIDGE * np.eye(counts.shape[1])
    whitening = np.linalg.inv(np.linalg.cholesky(noise))
    _, vectors = np.linalg.eigh(whitening @ (slow.T @ slow / len(slow)) @ whitening.T)
    return np.asarray(whitening.T @ vectors[:, -1], np.float64)


def _samples(time: float, rate: float) -> int:
    return max(round(time * rate), 1)

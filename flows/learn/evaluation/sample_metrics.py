"""Metrics of decisions sample by sample: confusion, ROC, reliability, errors near changes of the label."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.learn.sampling import Sampling
from flows.learn.train_extra import sklearn
from operators import ms
from operators.batch import Codes, Flags, Reals

BINS: Final = 10  # of the reliability curve
_POINTS: Final = 201  # of a stored ROC curve
EDGES: Final = (0, 20, 40, 60, 80, 100, 150, 200, 300, 400)  # ms, of the bins; the last has no end


@dataclass(frozen=True, slots=True, eq=False)
class Confusion:
    """Counts of static and slip samples by predicted class.

    >>> confusion = Confusion.of(np.array([True, True, False, False]), np.array([True, False, False, False]))
    >>> confusion.accuracy, confusion.recalls
    (75.0, (66.66666666666667, 100.0))
    """

    counts: Reals  # (2, 2) row: label static, slip; column: predicted static, slip

    @classmethod
    def of(cls, predicted: Flags, truth: Flags) -> Self:
        """Count predictions (k,) by truth (k,)."""
        return cls(np.bincount(2 * truth + predicted, minlength=4).reshape(2, 2).astype(np.float64))

    @property
    def accuracy(self) -> float:
        """Share of correct predictions, %."""
        return percent(np.trace(self.counts), self.counts.sum())

    @property
    def recalls(self) -> tuple[float, float]:
        """Recall of static and of slip, %."""
        static, slip = self.counts
        return percent(static[0], static.sum()), percent(slip[1], slip.sum())

    @property
    def balanced(self) -> float:
        """Balanced accuracy: mean of the two recalls, %."""
        return sum(self.recalls) / 2

    @property
    def precision(self) -> float:
        """Precision averaged over the classes by their share, as in the paper's tables; %.

        The recall averaged in this way equals the accuracy.
        """
        return self._weighted()[0]

    @property
    def f1(self) -> float:
        """F1 averaged over the classes by their share, as in the paper's tables; %."""
        return self._weighted()[1]

    def _weighted(self) -> tuple[float, float]:
        if not self.counts.any():
            return np.nan, np.nan
        precision, _, f1, _ = sklearn("metrics").precision_recall_fscore_support(
            [0, 0, 1, 1], [0, 1, 0, 1],
            sample_weight=self.counts.ravel(), average="weighted", zero_division=0,
        )  # fmt: skip
        return 100 * float(precision), 100 * float(f1)


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """Receiver operating characteristic."""

    false: Reals  # (201,) false positive rate, 0 to 1
    true: Reals  # (201,) true positive rate, 0 to 1
    area: float  # under the curve through all its points; NaN if a class is missing

    @classmethod
    def of(cls, probability: Reals, truth: Flags) -> Self:
        """Compute the curve of probabilities (k,), none of them NaN, against the truth (k,)."""
        grid = np.linspace(0, 1, _POINTS)
        if not truth.any() or truth.all():
            return cls(grid, np.full(_POINTS, np.nan), np.nan)
        metrics = sklearn("metrics")
        false, true, _ = metrics.roc_curve(truth, probability)
        curve: Reals = np.interp(grid, np.asarray(false), np.asarray(true))
        return cls(grid, curve, float(metrics.auc(false, true)))


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """Share of slip among samples of similar probability, in ten bins of equal width.

    scikit-learn's `calibration_curve` gives no number of samples, which the calibration error needs.
    """

    number: NDArray[np.intp]  # (10,) samples in each bin
    probability: Reals  # (10,) their mean probability; NaN in empty bins
    slip: Reals  # (10,) the share of slip among them

    @classmethod
    def of(cls, probability: Reals, truth: Flags) -> Self:
        """Sort probabilities (k,), none of them NaN, into bins."""
        bins = np.minimum((probability * BINS).astype(np.intp), BINS - 1)
        number = np.bincount(bins, minlength=BINS)
        some = np.where(number, number, np.nan)
        sums = [np.bincount(bins, weights=values, minlength=BINS) for values in (probability, truth)]
        return cls(number, sums[0] / some, sums[1] / some)

    @property
    def error(self) -> float:
        """Expected calibration error: mean distance of a bin's share from its probability, by samples; %."""
        distance = np.where(self.number, np.abs(self.probability - self.slip), 0)
        return percent(float(distance @ self.number), self.number.sum())


@dataclass(frozen=True, slots=True, eq=False)
class LabelChanges:
    """Samples and errors by distance from the nearest change of the label."""

    samples: NDArray[np.intp]  # (10,) in each bin of `EDGES`
    errors: NDArray[np.intp]  # (10,) number of these that are wrong
    sampling: Sampling

    @classmethod
    def of(
        cls,
        labels: Sequence[Codes],
        evaluated: Sequence[NDArray[np.intp]],
        wrong: Sequence[Flags],
        sampling: Sampling,
    ) -> Self:
        """Count errors (j,) at the evaluated samples (j,) of each recording with labels (n,)."""
        samples, errors = np.zeros((2, len(EDGES)), np.intp)
        for label, at, error in zip(labels, evaluated, wrong, strict=True):
            bins = np.searchsorted(EDGES, distance(label, sampling)[at], "right") - 1
            samples += np.bincount(bins, minlength=len(EDGES))
            errors += np.bincount(bins[error], minlength=len(EDGES))
        return cls(samples, errors, sampling)

    @property
    def spans(self) -> list[str]:
        """Distance of the first and of the last sample in each bin but the last, ms, as text."""
        step = self.sampling.period / ms
        return [f"{low}-{max(high - step, low):.0f}" for low, high in pairwise(EDGES)]

    @property
    def accuracy(self) -> Reals:
        """Share of correct predictions in each bin, %; (10,), NaN where there are no samples."""
        right = self.samples - self.errors
        return np.array([percent(*counts) for counts in zip(right, self.samples, strict=True)])

    def near(self, within: int) -> float:
        """Return the share of all errors within `within` ms (one of `EDGES`) of a change; %."""
        return percent(self.errors[: EDGES.index(within)].sum(), self.errors.sum())

    def far(self, beyond: int) -> float:
        """Return the accuracy at `beyond` ms (one of `EDGES`) or more from any change; %."""
        part = slice(EDGES.index(beyond), None)
        samples = self.samples[part].sum()
        return percent(samples - self.errors[part].sum(), samples)


def distance(label: Codes, sampling: Sampling) -> Reals:
    """Return the distance of each sample (n,) from the nearest change of the label; (n,) ms.

    It is 0 for the two samples at a change, and infinite if the label never changes.

    >>> distance(np.array([0, 0, 1, 1, 1], np.int8), Sampling()).tolist()
    [10.0, 0.0, 0.0, 10.0, 20.0]
    """
    same = np.diff(label) == 0
    within = np.append(same, True) & np.insert(same, 0, True)  # (n,) not at a change
    if within.all():
        return np.full(len(label), np.inf)
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415 - slow to import

    steps: Reals = distance_transform_edt(within)
    return steps * (sampling.period / ms)


def percent(part: float, whole: float) -> float:
    """Return the part of a whole in %; NaN if the whole is 0."""
    return 100 * float(part) / float(whole) if whole else float("nan")

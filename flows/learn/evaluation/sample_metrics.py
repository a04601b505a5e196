"""Measures of decisions that are made sample by sample: confusion, ROC, reliability."""

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from operators.batch import Flags, Reals

BINS: Final = 10  # of the reliability curve
_POINTS: Final = 201  # that an ROC is kept at


@dataclass(frozen=True, slots=True, eq=False)
class Confusion:
    """How many samples of static and of slip were called what.

    >>> confusion = Confusion.of(np.array([True, True, False, False]), np.array([True, False, False, False]))
    >>> confusion.accuracy, confusion.recalls
    (75.0, (66.66666666666667, 100.0))
    """

    counts: Reals  # (2, 2) truth static, slip; answer static, slip

    @classmethod
    def of(cls, called: Flags, truth: Flags) -> Self:
        """Count answers (k,) against the truth (k,)."""
        return cls(np.bincount(2 * truth + called, minlength=4).reshape(2, 2).astype(np.float64))

    @property
    def accuracy(self) -> float:
        """Share of right answers, %."""
        return percent(np.trace(self.counts), self.counts.sum())

    @property
    def recalls(self) -> tuple[float, float]:
        """Share of static and of slip that is recognised, %."""
        static, slip = self.counts
        return percent(static[0], static.sum()), percent(slip[1], slip.sum())

    @property
    def balanced(self) -> float:
        """Mean of the two recalls, %."""
        return sum(self.recalls) / 2

    @property
    def precision(self) -> float:
        """Precision of each class, weighted by its share, as in the paper's tables; %."""
        return self._weighted(np.diag(self.counts) / np.maximum(self.counts.sum(axis=0), 1))

    @property
    def recall(self) -> float:
        """Recall of each class, weighted by its share; always the accuracy; %."""
        return self._weighted(np.diag(self.counts) / np.maximum(self.counts.sum(axis=1), 1))

    @property
    def f1(self) -> float:
        """F1 of each class, weighted by its share, as in the paper's tables; %."""
        truth, called = self.counts.sum(axis=1), self.counts.sum(axis=0)
        return self._weighted(2 * np.diag(self.counts) / np.maximum(truth + called, 1))

    def _weighted(self, each: Reals) -> float:  # (2,)
        truth = self.counts.sum(axis=1)
        return percent(float(each @ truth), truth.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """Slip that is recognised against static that is called slip, over all thresholds."""

    false: Reals  # (201,) share of static called slip, 0 to 1
    true: Reals  # (201,) share of slip called slip there
    area: float  # under the curve, of all its points; NaN where one class is missing

    @classmethod
    def of(cls, probability: Reals, truth: Flags) -> Self:
        """The curve of probabilities (k,), none of them NaN, against the truth (k,)."""
        order = np.argsort(-probability, kind="stable")
        last = np.append(np.diff(probability[order]) != 0, True)[: len(order)]  # equal ones go together
        slip = np.cumsum(truth[order], dtype=np.intp)[last]
        static = np.cumsum(~truth[order], dtype=np.intp)[last]
        grid = np.linspace(0, 1, _POINTS)
        if not len(slip) or not slip[-1] or not static[-1]:
            return cls(grid, np.full(_POINTS, np.nan), float("nan"))
        true = np.concatenate(([0.0], slip / slip[-1]))
        false = np.concatenate(([0.0], static / static[-1]))
        area = float((np.diff(false) * (true[1:] + true[:-1])).sum() / 2)
        return cls(grid, np.interp(grid, false, true), area)


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """The share of slip among samples of about equal probability, in ten bins of equal width."""

    number: NDArray[np.intp]  # (10,) samples of each bin
    sure: Reals  # (10,) their mean probability; NaN where there are none
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
        """The expected calibration error: the mean over the samples of how far their bin is off; %."""
        off = np.where(self.number, np.abs(self.sure - self.slip), 0)
        return percent(float(off @ self.number), self.number.sum())


def percent(part: float, whole: float) -> float:
    """The part of a whole in %; NaN if the whole is 0."""
    return 100 * float(part) / float(whole) if whole else float("nan")


def known(value: float, digits: int | None = None) -> float | None:
    """A number for JSON: None for NaN and infinity, which it lacks; rounded if `digits` are given.

    >>> known(1.5), known(math.nan), known(93.14159, 3)
    (1.5, None, 93.142)
    """
    if not math.isfinite(value):
        return None
    return value if digits is None else round(value, digits)

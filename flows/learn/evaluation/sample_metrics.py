"""Metrics of samples: confusion of slip and static, calibration, and distance from a change of the label."""

from typing import Final

import numpy as np

from flows.learn.sampling import Sampling
from flows.report.results import ratio
from operators import ms
from operators.batch import Codes, Flags, Reals

BINS: Final = 10  # of the probability, for the calibration error


def confusion(predicted: Flags, truth: Flags) -> Reals:
    """Count predictions (k,) by truth (k,).

    Returns:
        (2, 2) row: static, slip; column: predicted static, slip.

    >>> confusion(np.array([True, True, False, False]), np.array([True, False, False, False])).tolist()
    [[2.0, 1.0], [0.0, 1.0]]
    """
    return np.bincount(2 * truth + predicted, minlength=4).reshape(2, 2).astype(np.float64)


def accuracy(counts: Reals) -> Reals:
    """Compute the share of correct predictions in confusions (..., 2, 2); (...) %."""
    return 100 * ratio(np.trace(counts, axis1=-2, axis2=-1), counts.sum(axis=(-2, -1)))


def balanced(counts: Reals) -> Reals:
    """Compute the balanced accuracy of confusions (..., 2, 2): the mean of both recalls; (...) %."""
    right = np.diagonal(counts, axis1=-2, axis2=-1)
    found: Reals = 100 * ratio(right, counts.sum(axis=-1)).sum(axis=-1) / 2
    return found


def precision(counts: Reals) -> Reals:
    """Compute the precision averaged over the classes by their share, as in the paper's tables; (...) %.

    The recall averaged in this way equals the accuracy. A class that is never predicted has precision 0.
    """
    right = np.diagonal(counts, axis1=-2, axis2=-1)
    return _weighted(counts, np.nan_to_num(ratio(right, counts.sum(axis=-2))))


def f1(counts: Reals) -> Reals:
    """Compute F1 averaged over the classes by their share, as in the paper's tables; (...) %."""
    right = np.diagonal(counts, axis1=-2, axis2=-1)
    return _weighted(counts, np.nan_to_num(ratio(2 * right, counts.sum(axis=-1) + counts.sum(axis=-2))))


def _weighted(counts: Reals, of_class: Reals) -> Reals:
    """Average a share of each class (..., 2) by the number of its samples; (...) %."""
    samples = counts.sum(axis=-1)
    return 100 * ratio((samples * of_class).sum(axis=-1), samples.sum(axis=-1))


def calibration_gaps(probability: Reals, truth: Flags) -> Reals:
    """Sum probability minus slip over the samples (k,) in each of ten bins of the probability; (10,)."""
    bins = np.minimum((probability * BINS).astype(np.intp), BINS - 1)
    return np.bincount(bins, probability - truth, BINS).astype(np.float64)


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
    from scipy.ndimage import distance_transform_edt

    steps: Reals = distance_transform_edt(within)
    return steps * (sampling.period / ms)


def percent(part: float, whole: float) -> float:
    """Return the part of a whole in %; NaN if the whole is 0."""
    return 100 * float(part) / float(whole) if whole else float("nan")

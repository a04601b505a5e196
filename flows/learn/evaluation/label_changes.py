"""Accuracy by distance from the nearest change of the label, which is uncertain by about 50 ms."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from flows.learn.evaluation.sample_metrics import percent
from operators.batch import Codes, Flags, Reals

EDGES: Final = (0, 20, 40, 60, 80, 100, 150, 200, 300, 400)  # ms, of the bins; the last has no end
_PERIOD: Final = 10  # ms


@dataclass(frozen=True, slots=True, eq=False)
class LabelChanges:
    """Samples and errors by distance from the nearest change of the label."""

    samples: NDArray[np.intp]  # (10,) in each bin of `EDGES`
    errors: NDArray[np.intp]  # (10,) number of these that are wrong

    @classmethod
    def of(
        cls, labels: Sequence[Codes], evaluated: Sequence[NDArray[np.intp]], wrong: Sequence[Flags]
    ) -> Self:
        """Count errors (j,) at the evaluated samples (j,) of each recording with labels (n,)."""
        samples, errors = np.zeros((2, len(EDGES)), np.intp)
        for label, at, error in zip(labels, evaluated, wrong, strict=True):
            bins = np.searchsorted(EDGES, distance(label)[at], "right") - 1
            samples += np.bincount(bins, minlength=len(EDGES))
            errors += np.bincount(bins[error], minlength=len(EDGES))
        return cls(samples, errors)

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


def distance(label: Codes) -> Reals:
    """Return the distance of each sample (n,) from the nearest change of the label; (n,) ms.

    It is 0 for the two samples at a change, and infinite if the label never changes.

    >>> distance(np.array([0, 0, 1, 1, 1], np.int8)).tolist()
    [10.0, 0.0, 0.0, 10.0, 20.0]
    """
    number = np.arange(len(label))
    changes = np.flatnonzero(np.diff(label))  # the sample before each
    if not len(changes):
        return np.full(len(label), np.inf)
    after = changes.searchsorted(number)  # the first change at or after each sample
    ahead = changes[np.minimum(after, len(changes) - 1)] - number
    behind = number - changes[np.maximum(after - 1, 0)] - 1
    steps = np.where(ahead < 0, behind, np.where(behind < 0, ahead, np.minimum(ahead, behind)))
    return steps * float(_PERIOD)

"""Calibration of a trained network's probability, folded into its output layer."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import expit, logit

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.trained_model import Arrays
from operators.batch import SLIP, UNKNOWN, Flags, Reals
from operators.detectors import Detector

_CERTAIN: Final = 1e-12  # distance from 0 and 1 at which logits are cut off
_MIN_SCALE: Final = 0.01  # keeps the order of samples even if validation contradicts the network


@dataclass(frozen=True, slots=True)
class Calibration:
    """Linear change of the network's logit: divided by a temperature, then shifted."""

    temperature: float
    bias: float

    @classmethod
    def fitted(cls, probability: Reals, slip: Flags) -> "Calibration":
        """Fit probabilities (k,) to the truth (k,) by maximum likelihood, with the targets of Platt.

        These targets keep the temperature above 0 where the classes are perfectly separated. If a class is
        missing, nothing changes.

        References:
            Platt, "Probabilistic outputs for support vector machines" (1999).
        """
        from scipy.optimize import minimize

        if not slip.any() or slip.all():
            return cls(1.0, 0.0)
        logits: Reals = logit(np.clip(probability, _CERTAIN, 1 - _CERTAIN))
        slips = int(slip.sum())
        target = np.where(slip, (slips + 1) / (slips + 2), 1 / (slip.size - slips + 2))

        def loss(change: Reals) -> tuple[float, Reals]:
            found: Reals = change[0] * logits + change[1]
            error: Reals = expit(found) - target
            value = float(np.mean(np.logaddexp(0, found) - target * found))
            return value, np.array([float(np.mean(error * logits)), float(np.mean(error))])

        best = minimize(
            loss, [1.0, 0.0], jac=True, method="L-BFGS-B", bounds=[(_MIN_SCALE, None), (None, None)]
        )
        return cls(1 / float(best.x[0]), float(best.x[1]))

    def fold(self, arrays: Arrays) -> Arrays:
        """Return weights whose output layer contains the calibration.

        The layer has one output, or two of which the second is slip.
        """
        kernel, bias = arrays["out/kernel"], arrays["out/bias"]
        shifted = bias / self.temperature
        shifted[-1] += self.bias
        changed = {"out/kernel": kernel / self.temperature, "out/bias": shifted}
        return {**arrays, **{name: each.astype(arrays[name].dtype) for name, each in changed.items()}}


def calibration_of(detector: Detector, validation: Sequence[LabelledRecording]) -> Calibration:
    """Fit the calibration of a detector to all labelled samples that have a probability."""
    probability = np.concatenate([each.probabilities(detector) for each in validation])
    label = np.concatenate([each.label for each in validation])
    known = (label != UNKNOWN) & ~np.isnan(probability)
    return Calibration.fitted(probability[known], label[known] == SLIP)

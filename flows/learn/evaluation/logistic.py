"""Logistic regression on simple features: what costs next to nothing, to compare with."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from operators.batch import Counts, Flags, Reals


@dataclass(frozen=True, eq=False)
class Logistic:
    """Logistic regression on features that cost next to nothing.

    Over the newest 50, 100, 200 and 400 ms: the variance of each barometer and the mean square of its steps,
    as log(1 + x), each sorted over the barometers so that it does not matter which one feels it. 48 features.
    """

    weights: Reals  # (49,) of the standardised features, and the bias
    mean: Reals  # (48,)
    std: Reals  # (48,)
    length: int = 41  # samples
    name = "logistic"

    @classmethod
    def fitted(cls, seen: Counts, slip: Flags, decay: float = 1e-3) -> Self:
        """Fit to windows (n, 41, 6) with both classes weighing the same; `decay` is the L2 penalty."""
        from scipy.optimize import minimize  # noqa: PLC0415 - takes long to import

        x = features(seen)
        mean, std = x.mean(axis=0), x.std(axis=0) + 1e-9
        x = np.column_stack(((x - mean) / std, np.ones(len(x))))
        number = np.bincount(slip, minlength=2).clip(1).astype(np.float64)  # (2,) of static, of slip
        share = 0.5 / number[slip.astype(np.intp)]  # (n,)
        sign = np.where(slip, 1.0, -1.0)

        def loss(weights: Reals) -> tuple[float, Reals]:
            margin: Reals = sign * (x @ weights)
            slope: Reals = np.asarray(-sign * share / (1 + np.exp(np.clip(margin, -500, 500))), np.float64)
            penalty = np.append(decay * weights[:-1], 0.0)
            value = float(share @ np.logaddexp(0, -margin) + penalty @ weights / 2)
            gradient: Reals = slope @ x + penalty
            return value, gradient

        found = minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 300})
        return cls(np.asarray(found.x, np.float64), mean, std)

    def score(self, windows: Counts | Reals) -> Reals:
        """The probability of slip of each window (n, 41, 6); (n,)."""
        x = (features(windows) - self.mean) / self.std
        logit = x @ self.weights[:-1] + self.weights[-1]
        probability: Reals = 1 / (1 + np.exp(-np.clip(logit, -500, 500)))
        return probability


def features(windows: Counts | Reals) -> Reals:
    """What `Logistic` sees of windows (n, 41, 6); (n, 48)."""
    values = windows.astype(np.float64)
    steps = np.square(np.diff(values, axis=1))  # (n, 40, 6)
    parts: list[Reals] = []
    for length in (5, 10, 20, 40):
        parts += [values[:, -length:].var(axis=1), steps[:, -length:].mean(axis=1)]
    return np.log1p(np.sort(np.stack(parts, axis=1), axis=2)).reshape(len(windows), -1)

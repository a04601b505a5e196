"""Baselines on simple features, fitted by scikit-learn, for comparison with the networks."""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from flows.learn.train_extra import sklearn
from operators.batch import Counts, Flags, Reals

_STEPS: Final = 16  # number of newest steps that are separate features
_SPANS: Final = (5, 10, 20, 40)  # samples


@dataclass(frozen=True, eq=False)
class Logistic:
    """Logistic regression on 48 features of 0.41-s windows.

    Over the newest 50, 100, 200 and 400 ms: the variance of each cell and the mean square of its steps, as
    log(1 + x), each sorted over the cells, so that the order of the cells does not matter.
    """

    weights: Reals  # (48,) of the standardised features
    bias: float
    mean: Reals  # (48,)
    std: Reals  # (48,)
    length: int = 41  # samples
    name = "logistic"

    @classmethod
    def fitted(cls, windows: Counts, slip: Flags, decay: float = 1e-3) -> Self:
        """Fit to windows (n, 41, 6), both classes weighted equally; `decay` is the L2 penalty."""
        x = activity(windows)
        mean, std = x.mean(axis=0), x.std(axis=0) + 1e-9
        model = sklearn("linear_model").LogisticRegression(
            C=1 / (decay * len(x)), class_weight="balanced", tol=1e-6, max_iter=1000
        )
        model.fit((x - mean) / std, slip)
        return cls(model.coef_[0], float(model.intercept_[0]), mean, std)

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, 41, 6); (n,)."""
        logit = (activity(windows) - self.mean) / self.std @ self.weights + self.bias
        probability: Reals = 1 / (1 + np.exp(-np.clip(logit, -500, 500)))
        return probability


@dataclass(frozen=True, eq=False)
class GradientBoosting:
    """Histogram gradient boosting on 88 features of 0.41-s windows.

    The 48 of `Logistic`; the size of each of the newest 16 steps, summed over the cells; and the distance
    of the newest sample from the mean over the newest 50, 100, 200 and 400 ms, sorted over the cells.
    """

    model: Any  # a fitted HistGradientBoostingClassifier
    length: int = 41  # samples
    name = "gradient_boosting"

    @classmethod
    def fitted(cls, windows: Counts, slip: Flags, seed: int = 0) -> Self:
        """Fit to windows (n, 41, 6), both classes weighted equally."""
        model = sklearn("ensemble").HistGradientBoostingClassifier(
            max_iter=300, max_leaf_nodes=31, min_samples_leaf=40, l2_regularization=1.0,
            class_weight="balanced", early_stopping=False, random_state=seed,
        )  # fmt: skip
        model.fit(activity_and_steps(windows), slip)
        return cls(model)

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, 41, 6); (n,)."""
        probability: Reals = self.model.predict_proba(activity_and_steps(windows))[:, 1]
        return probability


def activity(windows: Counts | Reals) -> Reals:
    """Return the features of `Logistic` for windows (n, 41, 6); (n, 48)."""
    values = windows.astype(np.float64)
    steps = np.square(np.diff(values, axis=1))  # (n, 40, 6)
    parts: list[Reals] = []
    for length in _SPANS:
        parts += [values[:, -length:].var(axis=1), steps[:, -length:].mean(axis=1)]
    return np.log1p(np.sort(np.stack(parts, axis=1), axis=2)).reshape(len(windows), -1)


def activity_and_steps(windows: Counts | Reals) -> Reals:
    """Return the features of `GradientBoosting` for windows (n, 41, 6); (n, 88)."""
    values = windows.astype(np.float64)
    steps = np.square(np.diff(values[:, -_STEPS - 1 :], axis=1)).sum(axis=2)  # (n, 16)
    offsets = [np.sort(np.abs(values[:, -1] - values[:, -span:].mean(axis=1))) for span in _SPANS]  # (n, 6)
    return np.concatenate([activity(windows), np.log1p(steps), *offsets], axis=1)

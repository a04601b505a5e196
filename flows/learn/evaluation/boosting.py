"""Gradient boosting on simple features: the baseline that a network has to beat."""

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final, Self

import numpy as np

from flows.learn.evaluation import logistic
from operators.batch import Counts, Flags, Reals
from operators.errors import InputError

_STEPS: Final = 16  # newest ones that are seen one by one
_SPANS: Final = (5, 10, 20, 40)  # samples


@dataclass(frozen=True, eq=False)
class GradientBoosting:
    """Histogram gradient boosting (scikit-learn) on 88 features of 0.41-s windows.

    The 48 of `Logistic`; the size of each of the newest 16 steps over the barometers; and how far the mean
    over the newest 50, 100, 200 and 400 ms lies from the newest sample, sorted over the barometers.
    """

    model: Any  # a fitted HistGradientBoostingClassifier
    length: int = 41  # samples
    name = "gradient_boosting"

    @classmethod
    def fitted(cls, seen: Counts, slip: Flags, seed: int = 0) -> Self:
        """Fit to windows (n, 41, 6) with both classes weighing the same.

        Raises:
            InputError: if scikit-learn is not installed.
        """
        if find_spec("sklearn") is None:
            raise InputError(
                "gradient_boosting", "needs scikit-learn: in the clone, pip install -e '.[train]'"
            )
        ensemble: Any = import_module("sklearn.ensemble")  # an extra, and slow to import
        model = ensemble.HistGradientBoostingClassifier(
            max_iter=300, max_leaf_nodes=31, min_samples_leaf=40, l2_regularization=1.0,
            class_weight="balanced", early_stopping=False, random_state=seed,
        )  # fmt: skip
        model.fit(features(seen), slip)
        return cls(model)

    def score(self, windows: Counts | Reals) -> Reals:
        """The probability of slip of each window (n, 41, 6); (n,)."""
        probability: Reals = self.model.predict_proba(features(windows))[:, 1]
        return probability


def features(windows: Counts | Reals) -> Reals:
    """What `GradientBoosting` sees of windows (n, 41, 6); (n, 88)."""
    values = windows.astype(np.float64)
    steps = np.square(np.diff(values[:, -_STEPS - 1 :], axis=1)).sum(axis=2)  # (n, 16)
    moved = [np.sort(np.abs(values[:, -1] - values[:, -span:].mean(axis=1))) for span in _SPANS]  # (n, 6)
    return np.concatenate([logistic.features(windows), np.log1p(steps), *moved], axis=1)

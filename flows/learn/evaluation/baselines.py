"""Logistic regression on simple features, for comparison with the networks."""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, Self

import numpy as np

from flows.learn.labelled_recordings import Sampling
from operators.batch import Counts, Flags, Reals
from operators.extras import require_extra

_LAGS: Final = (3, 8, 20, 50)  # samples at 100 Hz
_DECAY: Final = 1e-3  # L2 penalty of logistic regression


def window_length(sampling: Sampling) -> int:
    """Return the samples of a window; below 100 Hz as many as at 100 Hz."""
    return sampling.scaled(max(_LAGS)) + 1


def features(windows: Counts | Reals, sampling: Sampling) -> Reals:
    """Return 20 features of windows (n, 51, cells) at 100 Hz for any number of cells; (n, 20).

    Over the newest 30, 80, 200 and 500 ms, as log(1 + x): the RMS step, the change since the oldest sample
    and the standard deviation, each the mean over the cells; the first two also of the largest cell.
    """
    values = windows.astype(np.float64)
    steps = np.square(np.diff(values, axis=1))
    parts: list[Reals] = []
    for span in map(sampling.scaled, _LAGS):
        step = np.sqrt(steps[:, -span:].mean(axis=1))  # (n, cells)
        change = np.abs(values[:, -1] - values[:, -1 - span])
        deviation = values[:, -span:].std(axis=1)
        parts += [step.mean(axis=1), change.mean(axis=1), deviation.mean(axis=1)]
        parts += [step.max(axis=1), change.max(axis=1)]
    return np.log1p(np.stack(parts, axis=1))


@dataclass(frozen=True, eq=False)
class Logistic:
    """Logistic regression on features of windows; both classes have the same weight."""

    sampling: Sampling
    mean: Reals  # (k,) of the features
    std: Reals  # (k,)
    model: Any  # of scikit-learn
    name = "logistic"

    @property
    def length(self) -> int:
        """Length of a window, samples."""
        return window_length(self.sampling)

    @classmethod
    def fitted(cls, windows: Counts, slip: Flags, sampling: Sampling) -> Self:
        """Fit the regression to windows (n, length, cells).

        Raises:
            InputError: if scikit-learn is not installed.
        """
        require_extra("baselines", "baselines")
        sklearn: Any = import_module("sklearn.linear_model")  # takes a second the first time
        found = features(windows, sampling)
        mean, std = found.mean(axis=0), found.std(axis=0) + 1e-9
        model = sklearn.LogisticRegression(
            C=1 / (_DECAY * len(found)), class_weight="balanced", tol=1e-6, max_iter=1000
        )
        model.fit((found - mean) / std, slip)
        return cls(sampling, mean, std, model)

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, length, cells); (n,)."""
        scaled = (features(windows, self.sampling) - self.mean) / self.std
        probability: Reals = self.model.predict_proba(scaled)[:, 1]
        return probability

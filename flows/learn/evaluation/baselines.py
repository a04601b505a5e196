"""Baselines on simple features, fitted by scikit-learn, for comparison with the networks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from typing import Any, Final, Self, TypeAlias

import numpy as np

from flows.learn.labelled_recordings import Sampling
from operators.batch import Counts, Flags, Reals
from operators.extras import require_extra

_STEPS: Final = 16  # number of newest steps that are separate features
_SPANS: Final = (5, 10, 20, 40)  # samples at 100 Hz
_LAGS: Final = (3, 8, 20, 50)  # samples at 100 Hz
_DECAY: Final = 1e-3  # L2 penalty of logistic regression
_BINS: Final = 255  # of a feature, most that scikit-learn takes


def sklearn(module: str) -> Any:
    """Import a module of scikit-learn, which is an extra and takes a second the first time.

    Raises:
        InputError: if it is not installed.
    """
    require_extra("baselines", "baselines")
    return import_module(f"sklearn.{module}")


def activity(windows: Counts | Reals, sampling: Sampling) -> Reals:
    """Return 48 features of windows (n, 41, 6) at 100 Hz, 8 for each cell; (n, 48).

    Over the newest 50, 100, 200 and 400 ms: the variance of each cell and the mean square of its steps, as
    log(1 + x), each sorted over the cells, so that the order of the cells does not matter.
    """
    values = windows.astype(np.float64)
    steps = np.square(np.diff(values, axis=1))  # (n, 40, 6)
    parts: list[Reals] = []
    for length in map(sampling.scaled, _SPANS):
        parts += [values[:, -length:].var(axis=1), steps[:, -length:].mean(axis=1)]
    return np.log1p(np.sort(np.stack(parts, axis=1), axis=2)).reshape(len(windows), -1)


def activity_and_steps(windows: Counts | Reals, sampling: Sampling) -> Reals:
    """Return 88 features of windows (n, 41, 6) at 100 Hz; (n, 88).

    The 48 of `activity`; the size of each of the newest 16 steps, summed over the cells; and the distance
    of the newest sample from the mean over the newest 50, 100, 200 and 400 ms, sorted over the cells.
    """
    values = windows.astype(np.float64)
    steps = np.square(np.diff(values[:, -_STEPS - 1 :], axis=1)).sum(axis=2)  # (n, 16)
    spans = map(sampling.scaled, _SPANS)
    offsets = [np.sort(np.abs(values[:, -1] - values[:, -span:].mean(axis=1))) for span in spans]  # (n, 6)
    return np.concatenate([activity(windows, sampling), np.log1p(steps), *offsets], axis=1)


def strokes(windows: Counts | Reals, sampling: Sampling) -> Reals:
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


@dataclass(frozen=True)
class Features:
    """Features of windows; below 100 Hz the windows have as many samples as at 100 Hz."""

    steps: int  # of a window at 100 Hz
    compute: Callable[[Counts | Reals, Sampling], Reals]  # windows (n, length, cells) to features (n, k)
    sampling: Sampling = field(default_factory=Sampling)

    @property
    def length(self) -> int:
        """Length of a window, samples."""
        return self.sampling.scaled(self.steps) + 1

    def at(self, sampling: Sampling) -> Self:
        """Return the features over the same times at another rate."""
        return replace(self, sampling=sampling)

    def of(self, windows: Counts | Reals) -> Reals:
        """Return the features of windows (n, length, cells); (n, k)."""
        return self.compute(windows, self.sampling)


ACTIVITY: Final = Features(40, activity)
ACTIVITY_AND_STEPS: Final = Features(40, activity_and_steps)
STROKES: Final = Features(50, strokes)


@dataclass(frozen=True, eq=False)
class Baseline:
    """Model on features of windows; fitting weights both classes equally."""

    name: str
    features: Features
    model: Any  # of scikit-learn
    prepare: Callable[[Reals], Reals]  # features (n, k) as the model takes them

    @property
    def length(self) -> int:
        """Length of a window, samples."""
        return self.features.length

    @classmethod
    def fitted(cls, name: str, windows: Counts, slip: Flags, features: Features) -> Self:
        """Fit logistic regression or gradient boosting (`MODELS`) to windows (n, length, cells)."""
        found = features.of(windows)
        model, prepare = MODELS[name](found)
        model.fit(prepare(found), slip)
        return cls(name, features, model, prepare)

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, length, cells); (n,)."""
        probability: Reals = self.model.predict_proba(self.prepare(self.features.of(windows)))[:, 1]
        return probability


Model: TypeAlias = tuple[Any, Callable[[Reals], Reals]]  # of scikit-learn; prepares its features


def _logistic(features: Reals) -> Model:
    model = sklearn("linear_model").LogisticRegression(
        C=1 / (_DECAY * len(features)), class_weight="balanced", tol=1e-6, max_iter=1000
    )
    return model, partial(_standardised, features.mean(axis=0), features.std(axis=0) + 1e-9)


def _standardised(mean: Reals, std: Reals, features: Reals) -> Reals:
    return (features - mean) / std


def _boosting(features: Reals) -> Model:
    model = sklearn("ensemble").HistGradientBoostingClassifier(
        max_iter=300, max_leaf_nodes=31, min_samples_leaf=40, l2_regularization=1.0,
        class_weight="balanced", early_stopping=False, random_state=0,
    )  # fmt: skip
    # scikit-learn 1.9 finds these bins with weights, one by one: several times the time of the fit
    return model, partial(_binned, np.quantile(features, np.arange(1, _BINS) / _BINS, axis=0))


def _binned(edges: Reals, features: Reals) -> Reals:
    """Return the number of the bin of each feature (n, k); edges (bins - 1, k)."""
    columns = zip(edges.T, features.T, strict=True)
    return np.stack([np.searchsorted(edge, column) for edge, column in columns], axis=1).astype(np.float64)


MODELS: Final[Mapping[str, Callable[[Reals], Model]]] = {
    "gradient_boosting": _boosting,
    "logistic": _logistic,
}

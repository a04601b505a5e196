"""Detectors that judge the scene, and how a detector's answers are counted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flows.trials import Trial
from operators.batch import SLIP, STATIC, Counts, Flags, Reals
from operators.detectors import Detector, Psd

_BLOCK: Final = 512  # windows scored at once


def windows(trial: Trial, length: int, hop: int) -> Counts:
    """The windows (k, length, 6) behind the judged samples of a trial."""
    view = sliding_window_view(trial.counts, length, axis=0)  # (n - length + 1, 6, length)
    picked: Counts = view[trial.judged(hop) + 1 - length].transpose(0, 2, 1)
    return picked


def labels(trials: Sequence[Trial], hop: int) -> Flags:
    """Whether each judged sample of the trials is slip; (k,)."""
    return np.concatenate([trial.slip[trial.judged(hop)] for trial in trials])


def answers(detector: Detector, trials: Sequence[Trial], hop: int) -> list[Flags]:
    """Whether the detector calls each judged sample of each trial slip."""
    result: list[Flags] = []
    for trial in trials:
        seen = windows(trial, detector.length, hop)
        blocks = [detector.score(seen[at : at + _BLOCK]) for at in range(0, len(seen), _BLOCK)]
        result.append(np.concatenate([np.empty(0), *blocks]) > 1 / 2)
    return result


@dataclass(frozen=True, slots=True)
class Tally:
    """How often slip and static were called slip."""

    counts: Reals  # (2, 2) truth static, slip; answer static, slip

    @classmethod
    def of(cls, called: Flags, truth: Flags) -> Self:
        """Count answers (k,) against the truth (k,)."""
        return cls(np.bincount(2 * truth + called, minlength=4).reshape(2, 2).astype(np.float64))

    @property
    def accuracy(self) -> float:
        """Share of right answers, %."""
        return _percent(np.trace(self.counts), self.counts.sum())

    @property
    def recalls(self) -> tuple[float, float]:
        """Share of static and of slip that is recognised, %."""
        static, slip = self.counts
        return _percent(static[0], static.sum()), _percent(slip[1], slip.sum())

    @property
    def balanced(self) -> float:
        """Mean of the two, %."""
        return sum(self.recalls) / 2

    @property
    def f1(self) -> float:
        """F1 of each class, weighted by its share, as in the paper's tables; %."""
        right, truth, called = np.diag(self.counts), self.counts.sum(axis=1), self.counts.sum(axis=0)
        each = 2 * right / np.maximum(truth + called, 1)  # (2,)
        return _percent(float(each @ truth), truth.sum())


def tally(detector: Detector, trials: Sequence[Trial], hop: int) -> Tally:
    """The detector's answers to all trials, counted."""
    return Tally.of(np.concatenate(answers(detector, trials, hop)), labels(trials, hop))


def _percent(part: float, whole: float) -> float:
    return 100 * float(part) / float(whole) if whole else float("nan")


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
    name = "logistic regression"

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


def fitted(trials: Sequence[Trial], hop: int) -> tuple[Psd, Logistic]:
    """The two detectors that need no training framework, fitted to trials."""
    slip = labels(trials, hop)
    codes = np.where(slip, SLIP, STATIC).astype(np.int8)
    psd, length = Psd(), 41
    seen = [np.concatenate([windows(trial, n, hop) for trial in trials]) for n in (psd.length, length)]
    return psd.fitted(seen[0], codes), Logistic.fitted(seen[1], slip)

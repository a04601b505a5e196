"""Methods to compare: shipped detectors, model files, and methods that are fitted to a fold."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from flows.learn.evaluation.baselines import Logistic, window_length
from flows.learn.evaluation.folds import Fold
from flows.learn.event_metrics import tuned_on
from flows.learn.labelled_recordings import Sampling
from flows.learn.training.recipe import REAL_TOUCH, Recipe
from operators import Debounce
from operators.batch import SLIP, STATIC, Counts
from operators.detectors import Detector, Psd, Tcn
from operators.errors import InputError
from operators.extras import require_extra
from storage import load_debounce, load_detector
from storage.models import load_card, shipped, shipped_names

PAPER_RULE: Final = Debounce(threshold=0.5, consecutive=2, release=2)  # in the paper's robot tests, 100 Hz
SHORT: Final = Recipe(steps=400, augmentation=REAL_TOUCH)
_PSD: Final = {"psd": 25, "psd_1s": 100}  # samples of a window at 100 Hz; the latter is the paper's
BASELINES: Final = (Logistic.name, *_PSD)
_HOP: Final = 5  # samples at 100 Hz between the windows that baselines are fitted to
_SUFFIX: Final = ".safetensors"


@dataclass(frozen=True, slots=True)
class FittedMethod:
    """Detector with its name in tables."""

    name: str
    detector: Detector
    debounce: Debounce | None = None  # None: not chosen yet
    chosen_on: str = "its card"  # origin of the debounce
    card: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of its model; empty: it has none

    def fit(self, _: Fold) -> "FittedMethod":
        """Return the method itself, which learns nothing from a fold."""
        return self

    def debounced(self, fold: Fold) -> "FittedMethod":
        """Return the method with its debounce, or one tuned on the validation, or that of the paper."""
        if self.debounce is not None:
            return self
        if fold.validation:
            return replace(self, debounce=tuned_on(fold.validation, self.detector), chosen_on="validation")
        return replace(self, debounce=fold.judged[0].sampling.rule(PAPER_RULE), chosen_on="the paper")


@dataclass(frozen=True, slots=True)
class Learner:
    """Method that is fitted to a fold first."""

    name: str
    learn: Callable[[Fold], Detector]  # a function of a module, or a partial of one: it is pickled

    def fit(self, fold: Fold) -> FittedMethod:
        """Return the method that has learned from the training of a fold."""
        return FittedMethod(self.name, self.learn(fold))


Candidate: TypeAlias = FittedMethod | Learner


def trained_methods(names: Collection[str] = ()) -> list[FittedMethod]:
    """Return the methods that have weights: shipped ones and model files.

    Args:
        names: Files of weights, which are added; and names: only these of the shipped ones.

    Raises:
        InputError: if a file does not hold the weights of a detector, or a name is unknown.
    """
    known = (*shipped_names(), *BASELINES)
    files = [name for name in dict.fromkeys(names) if name.endswith(_SUFFIX)]
    if unknown := sorted({*names} - {*files, *known}):
        raise InputError(", ".join(unknown), f"is not a method; known are {', '.join(known)}, FILE{_SUFFIX}")
    return [_loaded(model) for model in (*wanted(names, shipped_names()), *files)]


def wanted(names: Collection[str], known: Iterable[str]) -> list[str]:
    """Return the known names that are among `names`; all if these are files only."""
    chosen = [name for name in names if not name.endswith(_SUFFIX)]
    return [name for name in known if not chosen or name in chosen]


def baselines(names: Collection[str] = ()) -> list[Learner]:
    """Return the baselines, which are fitted to the train split; `names`: only these."""
    return [Learner(name, partial(fitted_baseline, name)) for name in wanted(names, BASELINES)]


def hold_out_methods(
    names: Collection[str] = (), *, train: bool = False, recipe: Recipe = SHORT
) -> list[Candidate]:
    """Return the methods without weights that are judged on held-out groups.

    Args:
        names: Only these: psd, and with `train` logistic and tcn; empty: all.
        train: Include those that learn from the other groups; else only psd with its default threshold.
        recipe: Size and training of the network.
    """
    found: dict[str, Candidate] = {"psd": FittedMethod("psd", Psd(), PAPER_RULE, "the paper")}
    if train:
        found[Logistic.name] = Learner(Logistic.name, partial(fitted_baseline, Logistic.name))
        found["tcn"] = Learner("tcn, trained", partial(_trained_tcn, recipe))
    return [found[name] for name in wanted(names, found)]


def fitted_baseline(name: str, fold: Fold) -> Detector:
    """Fit a baseline, one of `BASELINES`, to the training recordings of a fold.

    Raises:
        InputError: if the training has no slip or no static.
        ParameterError: if the rate is too low for the frequencies of a spectral detector.
    """
    training = fold.train
    sampling = training[0].sampling if training else Sampling()
    every = sampling.scaled(_HOP)
    slip = np.concatenate([np.empty(0, np.bool_), *(each.slip[each.known(every)] for each in training)])
    if slip.all() or not slip.any():
        raise InputError(name, "no training with slip and static is left to fit it to")

    def seen(length: int) -> Counts:
        return np.concatenate([recording.windows(length, every) for recording in training])

    if name in _PSD:
        fingertip = training[0].fingertip
        psd = Psd(sampling.scaled(_PSD[name]), fingertip=fingertip)
        return psd.fitted(seen(psd.length), np.where(slip, SLIP, STATIC).astype(np.int8))
    return Logistic.fitted(seen(window_length(sampling)), slip, sampling)


def _trained_tcn(recipe: Recipe, fold: Fold) -> Detector:
    """Train our network."""
    require_extra("train", "--train")
    from flows.learn.training.dense_training import train_dense

    detector = Tcn(train_dense(fold.train, fold.validation, recipe).arrays)
    detector.fingertip = fold.train[0].fingertip
    return detector


def _loaded(model: str) -> FittedMethod:
    card = load_card(shipped(model) or Path(model))
    debounce = load_debounce(model) if "debounce" in card else None
    return FittedMethod(model, load_detector(model), debounce, card=card)

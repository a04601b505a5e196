"""Methods to compare: shipped detectors, model files, and baselines that are fitted to a fold."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from flows.learn.evaluation.baselines import ACTIVITY, ACTIVITY_AND_STEPS, Baseline, Features
from flows.learn.evaluation.debounce_tuning import tuned_on
from flows.learn.evaluation.folds import Fold
from flows.learn.sampling import Sampling
from flows.learn.scoring import labels, windows
from operators import Debounce
from operators.batch import SLIP, STATIC, Counts
from operators.detectors import TRAINED, Detector, Psd
from operators.errors import InputError
from storage import load_debounce, load_detector
from storage.models import load_card, shipped_names, shipped_path

PAPER_RULE: Final = Debounce(threshold=0.5, consecutive=2, release=2)  # in the paper's robot tests, 100 Hz
_HOP: Final = 5  # samples at 100 Hz between the windows that baselines are fitted to
_PSD: Final = {"psd": 25, "psd_1s": 100}  # samples of a window at 100 Hz; the latter is the paper's
_FITTED: Final = {"gradient_boosting": ACTIVITY_AND_STEPS, "logistic": ACTIVITY}
BASELINES: Final = (*_FITTED, *_PSD)


@dataclass(frozen=True, slots=True)
class Method:
    """Detector with its name in tables."""

    name: str
    detector: Detector
    debounce: Debounce | None = None  # None: its card has none
    card: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of its model; empty: it has none


@dataclass(frozen=True, slots=True)
class Candidate:
    """Method that may have to be fitted first."""

    name: str
    fit: Callable[[Fold], Method]  # a function of a module, or a partial of one: it is pickled


def trained_methods(models: Sequence[Path] = (), names: Collection[str] = ()) -> list[Method]:
    """Return the methods that have weights: shipped ones and model files.

    Args:
        models: Files of weights to compare as well.
        names: Only these methods, and those of `models`; empty: all.

    Raises:
        InputError: if a file does not hold the weights of a detector, or a name is unknown.
    """
    known = (*shipped_names(), *BASELINES)
    if unknown := sorted({*names} - {*known, *TRAINED}):
        raise InputError(", ".join(unknown), f"is not a method; known are {', '.join(known)}")
    judged = [name for name in known if not names or name in names]
    found = [_shipped(name) for name in judged if name not in BASELINES]
    for path in models:
        found.append(_of_file(path, {*judged, *(each.name for each in found)}))
    return found


def ready(methods: Sequence[Method]) -> list[Candidate]:
    """Return methods as candidates that learn nothing from a fold."""
    return [Candidate(method.name, partial(_as_it_is, method)) for method in methods]


def baselines(names: Collection[str] = ()) -> list[Candidate]:
    """Return the baselines, which are fitted to the train split; `names`: only these."""
    return [
        Candidate(name, partial(fitted_baseline, name)) for name in BASELINES if not names or name in names
    ]


def default_psd(names: Collection[str] = ()) -> list[Candidate]:
    """Return the spectral detector with its default threshold, which learns nothing from a fold."""
    psd = Method("psd", Psd())
    return ready([psd]) if not names or psd.name in names else []


def choose_debounce(method: Method, fold: Fold) -> tuple[Debounce, str]:
    """Choose the debounce of a method: of its card, tuned on validation recordings, or that of the paper.

    Returns:
        The debounce, and where it comes from.
    """
    if method.debounce is not None:
        return method.debounce, "its card"
    if fold.validation:
        return tuned_on(fold.validation, method.detector), "validation"
    return fold.judged[0].sampling.rule(PAPER_RULE), "the paper"


def fitted_baseline(name: str, fold: Fold, *, features: Features | None = None, hop: int = _HOP) -> Method:
    """Fit a baseline to the training of a fold.

    Args:
        name: One of `BASELINES`.
        fold: Its training recordings are learned from.
        features: Features of the windows; None: those of the baseline.
        hop: Samples at 100 Hz from one window to the next.

    Raises:
        InputError: if the training has no slip or no static.
        ParameterError: if the rate is too low for the frequencies of a spectral detector.
    """
    training = fold.train
    sampling = training[0].sampling if training else Sampling()
    every = sampling.scaled(hop)
    slip = labels(training, every) if training else np.empty(0, np.bool_)
    if slip.all() or not slip.any():
        raise InputError(name, "no training with slip and static is left to fit it to")

    def seen(length: int) -> Counts:
        return np.concatenate([windows(recording, length, every) for recording in training])

    detector: Detector
    if name in _PSD:
        fingertip = training[0].fingertip
        psd = Psd(sampling.scaled(_PSD[name]), rate=fingertip.rate, fingertip=fingertip)
        detector = psd.fitted(seen(psd.length), np.where(slip, SLIP, STATIC).astype(np.int8))
    else:
        own = (features or _FITTED[name]).at(sampling)
        detector = Baseline.fitted(name, seen(own.length), slip, own)
    return Method(name, detector)


def _as_it_is(method: Method, _fold: Fold) -> Method:
    return method


def _shipped(name: str) -> Method:
    path = shipped_path(name)
    return Method(name, load_detector(name), load_debounce(path), load_card(path))


def _of_file(path: Path, taken: Collection[str]) -> Method:
    """Load a model under the name of its file, or its path as given if that name is taken."""
    name = str(path) if path.stem in taken else path.stem
    return Method(name, load_detector(path), load_debounce(path), load_card(path))

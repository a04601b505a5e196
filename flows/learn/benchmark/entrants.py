"""Entrants of the benchmark: what each regime makes of the training recordings of a fold."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from flows.learn.benchmark.fold_training import trained_tcn
from flows.learn.benchmark.folds import Fold, labelled_minutes
from flows.learn.evaluation.baselines import STROKES, GradientBoosting, Logistic
from flows.learn.evaluation.debounce_tuning import tuned_on
from flows.learn.evaluation.evaluation_study import PAPER_RULE
from flows.learn.evaluation.methods import SHIPPED, Method
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import labels, windows
from flows.learn.training.recipe import Recipe
from flows.learn.training.trainer import FURTHER_STEPS
from operators import Debounce, Score
from operators.batch import Counts, Reals
from operators.detectors import Detector, Psd, Tcn
from operators.detectors.weights import ForOneFingertip
from operators.errors import FingertipError, InputError
from operators.fingertip import Fingertip

Regime: TypeAlias = Literal["zero-shot", "few-shot", "in-domain"]
REGIMES: Final[tuple[Regime, ...]] = get_args(Regime)
MEANING: Final[Mapping[Regime, str]] = {
    "zero-shot": "shipped or given detectors as they are: no fitting",
    "few-shot": "fitted to two labelled minutes of the other {parts}",
    "in-domain": "fitted to all recordings of the other {parts}",
}
MINUTES: Final = 2.0  # labelled, few-shot
FEW_DRAWS: Final = 3  # of the labelled minutes
MAJORITY: Final = "majority"
DEFAULT: Final = "tcn"  # shipped detector that is trained on the folds
WIDE: Final = "tcn_wide"  # shipped detector for other fingertips than the TakkTile
NOT_BETTER: Final = "kept: not better"
_HOP: Final = 2  # samples at 100 Hz between the windows that baselines are fitted to


@dataclass(frozen=True, slots=True)
class Course:
    """Settings that entrants share."""

    recipe: Recipe
    models: Path  # folder of the trained folds
    seed: int = 0


class Fitted(NamedTuple):
    """Detector of a fold."""

    detector: Detector
    debounce: Debounce
    note: str = ""  # what did not happen


Fit: TypeAlias = Callable[[Fold, Course, int], Fitted]  # the last: number of the draw


@dataclass(frozen=True, slots=True)
class Entrant:
    """Detector in a regime."""

    regime: Regime
    name: str
    fit: Fit  # of a module, or a partial of one: it is pickled
    origin: str
    method: Method | None = None  # that is taken as it is
    draws: int = 1  # times that it is fitted to each fold
    cost: float = 1.0  # relative time of one fit

    @property
    def title(self) -> str:
        """Name with the regime."""
        return f"{self.regime} {self.name}"

    def rate(self, given: Fingertip) -> float:
        """Return the rate (Hz) at which it is judged: that of its detector, if the rest of `given` fits."""
        if self.method is None:
            return given.rate
        detector, rate = self.method.detector, given.rate
        if isinstance(detector, Psd):
            rate = detector.rate
        elif isinstance(detector, ForOneFingertip):
            rate = detector.fingertip.rate
        try:
            Score(detector).output_fingertip(replace(given, rate=rate))
        except FingertipError:
            return given.rate
        return rate


@dataclass(frozen=True)
class Majority:
    """Detector that gives every sample the answer that is right most often."""

    slip: bool
    length: int = 1  # samples
    name = MAJORITY

    def score(self, windows: Counts | Reals) -> Reals:
        """Return 1 or 0 for each window (n, 1, cells); (n,)."""
        return np.full(len(windows), float(self.slip))


def entrants(methods: Sequence[Method], regimes: Collection[str]) -> list[Entrant]:
    """Return the entrants of some regimes; `methods` are detectors with weights."""
    psd = Method("psd", Psd(), "default threshold")
    ready = [
        Entrant("zero-shot", each.name, partial(_as_it_is, each), each.origin, each, cost=4.0)
        for each in (*methods, psd)
    ]
    few = [
        Entrant("few-shot", name, partial(_few, name), "fitted", draws=FEW_DRAWS, cost=3.0)
        for name in _FITTED
    ]
    parents = [each for each in methods if isinstance(each.detector, Tcn) and _is_parent(each)]
    few += [
        Entrant("few-shot", each.name, partial(_tuned, each), "trained further", each, FEW_DRAWS, cost=50.0)
        for each in parents
    ]
    learned = [
        Entrant("in-domain", MAJORITY, _majority, "constant"),
        *(Entrant("in-domain", name, partial(_all, name), "fitted", cost=5.0) for name in _FITTED),
        Entrant("in-domain", DEFAULT, _tcn, "trained", cost=120.0),
    ]
    return [each for each in (*ready, *few, *learned) if each.regime in regimes]


def _is_parent(method: Method) -> bool:
    """Return True for detectors of strokes and given models: other shipped ones are for other tasks."""
    return method.name in {DEFAULT, WIDE} or method.origin != SHIPPED


def _paper_rule(fold: Fold) -> Debounce:
    return fold.train[0].sampling.rule(PAPER_RULE)


def _as_it_is(method: Method, fold: Fold, _course: Course, _draw: int) -> Fitted:
    return Fitted(method.detector, method.debounce or _paper_rule(fold))


def _majority(fold: Fold, _course: Course, _draw: int) -> Fitted:
    larger = bool(labels(fold.train, 1).mean() > 0.5)  # noqa: PLR2004 - the larger part
    return Fitted(Majority(larger), _paper_rule(fold))


def _few(name: str, fold: Fold, course: Course, draw: int) -> Fitted:
    """Fit to labelled minutes; one fitted to two thirds of each piece tunes the debounce on the rest."""
    found = labelled_minutes(fold, MINUTES, _draw_seed(course, draw))
    detector = _fitted(name, found)
    first = [each.piece(slice(len(each) * 2 // 3)) for each in found]
    rest = [each.piece(slice(len(each) * 2 // 3, None)) for each in found]
    try:
        return Fitted(detector, tuned_on(rest, _fitted(name, first)))
    except InputError:  # the pieces are too short
        return Fitted(detector, _paper_rule(fold))


def _tuned(method: Method, fold: Fold, course: Course, draw: int) -> Fitted:
    """Train further on labelled minutes; keep the old network unless the new one is better."""
    from flows.learn.training.fine_tuning import fine_tune  # noqa: PLC0415 - imports torch

    assert isinstance(method.detector, Tcn), "only these are trained further"
    recordings = labelled_minutes(fold, MINUTES, _draw_seed(course, draw))
    found = fine_tune(method.detector, recordings, (), Recipe(steps=FURTHER_STEPS, seed=course.seed))
    if not found.after["balanced"] > found.before["balanced"]:
        return Fitted(method.detector, method.debounce or _paper_rule(fold), NOT_BETTER)
    return Fitted(found.tcn, tuned_on(recordings, found.tcn))


def _draw_seed(course: Course, draw: int) -> int:
    return int(np.random.SeedSequence([course.seed, draw]).generate_state(1)[0])


def _all(name: str, fold: Fold, _course: Course, _draw: int) -> Fitted:
    """Fit to the recordings that the network is fitted to; its validation recordings tune the debounce."""
    fit, validation = fold.parts()
    detector = _fitted(name, fit)
    return Fitted(detector, tuned_on(validation, detector))


def _tcn(fold: Fold, course: Course, _draw: int) -> Fitted:
    return Fitted(*trained_tcn(fold, course.recipe, course.models))


def _fitted(name: str, recordings: Sequence[LabelledRecording]) -> Detector:
    sampling = recordings[0].sampling
    hop, features = sampling.scaled(_HOP), STROKES.at(sampling)
    slip = labels(recordings, hop)
    if slip.all() or not slip.any():
        raise InputError(name, "the recordings to fit to lack slip or static")
    seen = np.concatenate([windows(each, features.length, hop) for each in recordings])
    return _FITTED[name].fitted(seen, slip, features)


_FITTED: Final[Mapping[str, type[Logistic | GradientBoosting]]] = {
    "logistic": Logistic,
    "gradient_boosting": GradientBoosting,
}

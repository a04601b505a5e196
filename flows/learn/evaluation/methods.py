"""Methods to compare: shipped detectors, model files, and baselines fitted to a training split."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np

from flows.learn.evaluation.baselines import (
    ACTIVITY,
    ACTIVITY_AND_STEPS,
    Features,
    GradientBoosting,
    Logistic,
)
from flows.learn.labelled_recordings import TARGETS, LabelledRecording
from flows.learn.sampling import Sampling
from flows.learn.scoring import labels, windows
from operators import Debounce, Score
from operators.batch import SLIP, STATIC, Counts
from operators.detectors import TRAINED, Detector, Psd
from operators.errors import FingertipError, InputError, ParameterError
from operators.fingertip import Fingertip
from storage import load_debounce, load_detector
from storage.models import load_card, shipped, shipped_names

SHIPPED: Final = "ships"  # origin
_HOP: Final = 5  # samples at 100 Hz between the windows that baselines are fitted to

Log: TypeAlias = Callable[[str], object]


@dataclass(frozen=True, slots=True)
class Method:
    """Detector with its name in tables."""

    name: str
    detector: Detector
    origin: str
    debounce: Debounce | None = None  # from its model card
    target: str | None = TARGETS[0]  # that it was trained on, by its model card; None: the card does not say
    card: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of its model; empty: it has none


def trained_methods(models: Sequence[Path] = (), names: Collection[str] = ()) -> list[Method]:
    """Return the methods that have weights: shipped ones and model files.

    Args:
        models: Files of weights to compare as well.
        names: Only these methods, and those of `models`; empty: all.

    Raises:
        InputError: if a file does not hold the weights of a detector, or a name is unknown.
    """
    found = {method.name: method for method in map(_shipped, shipped_names())}
    given: list[str] = []
    for path in models:
        method = _of_file(path, found)
        found[method.name] = method
        given.append(method.name)
    unknown = sorted(set(names) - {*found, *_BASELINES, *TRAINED})
    if unknown:
        raise InputError(", ".join(unknown), f"is not a method; known are {', '.join([*found, *_BASELINES])}")
    return [method for name, method in found.items() if not names or name in {*names, *given}]


def for_fingertip(
    methods: Sequence[Method], fingertip: Fingertip, log: Log = lambda _: None
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods that were made for a fingertip, and the reasons why others were not, by name.

    Args:
        methods: Methods with weights.
        fingertip: Fingertip of the data.
        log: Receives the reasons.
    """
    found, missing = list[Method](), dict[str, str]()
    for method in methods:
        try:
            Score(method.detector).output_fingertip(fingertip)
            found.append(method)
        except FingertipError as error:
            missing[method.name] = str(error)
            log(f"not evaluated: {method.name}: {error}")
    return found, missing


def with_baselines(
    trained: Sequence[Method],
    training: Sequence[LabelledRecording],
    names: Collection[str] = (),
    log: Log = lambda _: None,
    misfits: Mapping[str, str] = MappingProxyType({}),
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods with weights and the baselines, and the reasons why others are missing, by name.

    Args:
        trained: Methods that `trained_methods` returned for `names`.
        training: Recordings that the baselines are fitted to.
        names: Only these methods; empty: all.
        log: Receives progress messages, and the reasons.
        misfits: Methods for other fingertips, as `for_fingertip` returned them.
    """
    found, loaded = list(trained), {method.name for method in trained}
    wanted = names or {*TRAINED, *_BASELINES}
    reason = "no model ships: give one as --model FILE"
    missing = {name: reason for name in TRAINED if name in wanted and name not in {*loaded, *misfits}}
    for name in _BASELINES:
        if name in wanted:
            log(f"fitting {name}")
            try:
                found.append(_fitted(name, training))
            except InputError as error:
                missing[name] = error.reason
            except ParameterError as error:  # such as a rate that is too low for the frequencies of psd
                missing[name] = str(error)
    for name, reason in missing.items():
        log(f"not evaluated: {name}: {reason}")
    return found, {**misfits, **missing}


_MODELS: Final[Mapping[str, tuple[type[Logistic | GradientBoosting], Features]]] = {
    "gradient_boosting": (GradientBoosting, ACTIVITY_AND_STEPS),
    "logistic": (Logistic, ACTIVITY),
}
_PSD: Final = {"psd": 25, "psd_1s": 100}  # samples of a window at 100 Hz; the latter is the paper's
_BASELINES: Final = (*_MODELS, *_PSD)


def _fitted(name: str, training: Sequence[LabelledRecording]) -> Method:
    sampling = training[0].sampling if training else Sampling()
    hop = sampling.scaled(_HOP)
    slip = labels(training, hop) if training else np.empty(0, np.bool_)
    if slip.all() or not slip.any():
        raise InputError(
            name,
            "no train split with slip and static is left to fit it to: evaluated recordings do not count",
        )

    def seen(length: int) -> Counts:
        return np.concatenate([windows(recording, length, hop) for recording in training])

    detector: Detector
    if name in _PSD:
        fingertip = training[0].fingertip
        psd = Psd(sampling.scaled(_PSD[name]), rate=fingertip.rate, fingertip=fingertip)
        detector = psd.fitted(seen(psd.length), np.where(slip, SLIP, STATIC).astype(np.int8))
    else:
        model, features = _MODELS[name]
        own = features.at(sampling)
        detector = model.fitted(seen(own.length), slip, own)
    return Method(name, detector, f"fitted to {len(slip)} windows")


def _shipped(name: str) -> Method:
    path = shipped(name)
    assert path is not None, "the caller asks for shipped ones only"
    card = load_card(path)
    return Method(name, load_detector(name), SHIPPED, load_debounce(path), card.get("target"), card)


def _of_file(path: Path, taken: Collection[str]) -> Method:
    """Load a model under the name of its detector, or of its file if that name is taken."""
    detector = load_detector(path)
    names = (detector.name, path.stem, *(f"{path.stem}_{number}" for number in range(2, 100)))
    name = next(name for name in names if name not in {*taken, *_BASELINES})
    card = load_card(path)
    return Method(name, detector, path.name, load_debounce(path), card.get("target"), card)

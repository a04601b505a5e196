"""Methods to compare: shipped detectors, model files, and baselines fitted to a training split."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from flows.learn.evaluation.baselines import ACTIVITY, ACTIVITY_AND_STEPS, GradientBoosting, Logistic
from flows.learn.labelled_recordings import TARGETS, LabelledRecording
from flows.learn.scoring import labels, windows
from operators import Debounce
from operators.batch import SLIP, STATIC, Counts, Flags
from operators.detectors import TRAINED, Detector, Psd
from operators.errors import InputError
from storage import load_debounce, load_detector
from storage.models import load_card, shipped, shipped_names

SHIPPED: Final = "ships"  # origin
_HOP: Final = 5  # samples between the windows that baselines are fitted to

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


def with_baselines(
    trained: Sequence[Method],
    training: Sequence[LabelledRecording],
    names: Collection[str] = (),
    log: Log = lambda _: None,
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods with weights and the baselines, and the reasons why others are missing, by name.

    Args:
        trained: Methods that `trained_methods` returned for `names`.
        training: Recordings that the baselines are fitted to.
        names: Only these methods; empty: all.
        log: Receives progress messages.
    """
    found, loaded = list(trained), {method.name for method in trained}
    wanted = names or {*TRAINED, *_BASELINES}
    reason = "no model ships: give one as --model FILE"
    missing = {name: reason for name in TRAINED if name in wanted and name not in loaded}
    for name, (length, fit) in _BASELINES.items():
        if name in wanted:
            log(f"fitting {name}")
            try:
                found.append(_fitted(name, length, fit, training))
            except InputError as error:
                missing[name] = error.reason
    return found, missing


def _psd(seen: Counts, slip: Flags, rate: float) -> Detector:
    return Psd(seen.shape[1], rate=rate).fitted(seen, np.where(slip, SLIP, STATIC).astype(np.int8))


# by name: length of a window, and function that fits a detector to windows and labels at a rate (Hz)
_BASELINES: Final[Mapping[str, tuple[int, Callable[[Counts, Flags, float], Detector]]]] = {
    "gradient_boosting": (
        ACTIVITY_AND_STEPS.length,
        lambda seen, slip, _: GradientBoosting.fitted(seen, slip),
    ),
    "logistic": (ACTIVITY.length, lambda seen, slip, _: Logistic.fitted(seen, slip)),
    "psd": (25, _psd),
    "psd_1s": (100, _psd),  # the paper's window
}


def _fitted(
    name: str,
    length: int,
    fit: Callable[[Counts, Flags, float], Detector],
    training: Sequence[LabelledRecording],
) -> Method:
    slip = labels(training, _HOP) if training else np.empty(0, np.bool_)
    if slip.all() or not slip.any():
        raise InputError(
            name, "no train split with slip and static is left to fit it to: judged recordings do not count"
        )
    seen = np.concatenate([windows(recording, length, _HOP) for recording in training])
    detector = fit(seen, slip, training[0].fingertip.rate)
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

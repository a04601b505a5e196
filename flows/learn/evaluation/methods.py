"""Methods to compare: shipped detectors, model files, and baselines fitted to a training split."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from flows.learn.evaluation.baselines import GradientBoosting, Logistic
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import labels, windows
from operators import Debounce
from operators.batch import SLIP, STATIC, Counts, Flags
from operators.detectors import TRAINED, Detector, Psd
from operators.errors import InputError
from storage import load_debounce, load_detector
from storage.models import shipped

_HOP: Final = 5  # samples between the windows that baselines are fitted to

Log: TypeAlias = Callable[[str], object]


@dataclass(frozen=True, slots=True)
class Method:
    """Detector with its name in tables."""

    name: str
    detector: Detector
    origin: str
    debounce: Debounce | None = None  # from its model card


def methods(
    training: Sequence[LabelledRecording],
    models: Sequence[Path] = (),
    names: Collection[str] = (),
    log: Log = lambda _: None,
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods, and the reasons why others are missing, by name.

    Args:
        training: Recordings that the baselines are fitted to.
        models: Files of weights to compare as well.
        names: Only these methods, and those of `models`; empty: all.
        log: Receives progress messages.

    Raises:
        InputError: if a file does not hold the weights of a detector, or a name is unknown.
    """
    found = {method.name: method for method in map(_shipped, filter(shipped, TRAINED))}
    given: list[str] = []
    for path in models:
        method = _of_file(path, found)
        found[method.name] = method
        given.append(method.name)
    unknown = sorted(set(names) - {*found, *_BASELINES, *TRAINED})
    if unknown:
        raise InputError(", ".join(unknown), f"is not a method; known are {', '.join([*found, *_BASELINES])}")
    missing = {name: "no model ships: give one as --model FILE" for name in TRAINED if name not in found}
    for name, (length, fit) in _BASELINES.items():
        if names and name not in names:
            continue
        log(f"fitting {name}")
        try:
            found[name] = _fitted(name, length, fit, training)
        except InputError as error:
            missing[name] = error.reason
    wanted = {*names, *given} if names else {*found, *missing}
    chosen = [method for name, method in found.items() if name in wanted]
    return chosen, {name: reason for name, reason in missing.items() if name in wanted}


def _psd(seen: Counts, slip: Flags) -> Detector:
    return Psd(seen.shape[1]).fitted(seen, np.where(slip, SLIP, STATIC).astype(np.int8))


# by name: length of a window, and function that fits a detector to windows and labels
_BASELINES: Final[Mapping[str, tuple[int, Callable[[Counts, Flags], Detector]]]] = {
    "gradient_boosting": (GradientBoosting.length, GradientBoosting.fitted),
    "logistic": (Logistic.length, Logistic.fitted),
    "psd": (25, _psd),
    "psd_1s": (100, _psd),  # the paper's window
}


def _fitted(
    name: str,
    length: int,
    fit: Callable[[Counts, Flags], Detector],
    training: Sequence[LabelledRecording],
) -> Method:
    slip = labels(training, _HOP) if training else np.empty(0, np.bool_)
    if slip.all() or not slip.any():
        raise InputError(name, "there is no training split with slip and static to fit it to")
    seen = np.concatenate([windows(recording, length, _HOP) for recording in training])
    return Method(name, fit(seen, slip), f"fitted to {len(slip)} windows")


def _shipped(name: str) -> Method:
    path = shipped(name)
    assert path is not None, "the caller asks for shipped ones only"
    return Method(name, load_detector(name), "ships", load_debounce(path))


def _of_file(path: Path, taken: Collection[str]) -> Method:
    """Load a model under the name of its detector, or of its file if that name is taken."""
    detector = load_detector(path)
    names = (detector.name, path.stem, *(f"{path.stem}_{number}" for number in range(2, 100)))
    name = next(name for name in names if name not in {*taken, *_BASELINES})
    return Method(name, detector, path.name, load_debounce(path))

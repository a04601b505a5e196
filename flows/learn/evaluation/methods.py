"""Which detectors are compared: those that ship, those in given files, those fitted to a training split."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from flows.learn.evaluation.boosting import GradientBoosting
from flows.learn.evaluation.logistic import Logistic
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import labels, windows
from operators import Debounce
from operators.batch import SLIP, STATIC, Counts
from operators.detectors import TRAINED, Detector, Psd
from operators.errors import InputError
from storage import load_debounce, load_detector
from storage.models import shipped

_HOP: Final = 5  # samples from one window to the next, of those that detectors are fitted to


@dataclass(frozen=True, slots=True)
class Method:
    """A detector, by the name that it has in tables."""

    name: str
    detector: Detector
    origin: str  # where it comes from
    debounce: Debounce | None = None  # how its model's card says that it is debounced


Told: TypeAlias = Callable[[str], object]


def methods(
    training: Sequence[LabelledRecording],
    models: Sequence[Path] = (),
    names: Collection[str] = (),
    told: Told = lambda _: None,
) -> tuple[list[Method], dict[str, str]]:
    """The methods, and by name why others are missing.

    Args:
        training: what the simple detectors are fitted to
        models: files of weights to compare as well
        names: only these, and those of `models`; empty: all
        told: is told what is being fitted

    Raises:
        InputError: if a file does not hold a detector's weights, or there is no such method.
    """
    found = {method.name: method for method in map(_shipped, filter(shipped, TRAINED))}
    given: list[str] = []
    for path in models:
        method = _of_file(path, found)
        found[method.name] = method
        given.append(method.name)
    unknown = sorted(set(names) - {*found, *FITTED, *TRAINED})
    if unknown:
        known = ", ".join([*found, *FITTED])
        raise InputError(", ".join(unknown), f"is no method: there are {known}")
    missing = {
        name: "no model of it ships: give one as --model FILE" for name in TRAINED if name not in found
    }
    for name, fit in FITTED.items():
        if names and name not in names:
            continue
        told(f"fitting {name}")
        try:
            found[name] = _fitted(name, fit, training)
        except InputError as error:
            missing[name] = error.reason
    wanted = {*names, *given} if names else {*found, *missing}
    return [found[name] for name in found if name in wanted], {
        name: reason for name, reason in missing.items() if name in wanted
    }


def _psd(length: int) -> Callable[[Sequence[LabelledRecording]], Detector]:
    def fitted(recordings: Sequence[LabelledRecording]) -> Detector:
        codes = np.where(labels(recordings, _HOP), SLIP, STATIC).astype(np.int8)
        return Psd(length).fitted(_seen(recordings, length), codes)

    return fitted


def _logistic(recordings: Sequence[LabelledRecording]) -> Detector:
    return Logistic.fitted(_seen(recordings, Logistic.length), labels(recordings, _HOP))


def _gradient_boosting(recordings: Sequence[LabelledRecording]) -> Detector:
    return GradientBoosting.fitted(_seen(recordings, GradientBoosting.length), labels(recordings, _HOP))


# by name, those that are fitted to the training split at hand
FITTED: Final[Mapping[str, Callable[[Sequence[LabelledRecording]], Detector]]] = {
    "gradient_boosting": _gradient_boosting,
    "logistic": _logistic,
    "psd": _psd(25),
    "psd_1s": _psd(100),  # the paper's window
}


def _seen(recordings: Sequence[LabelledRecording], length: int) -> Counts:
    return np.concatenate([windows(recording, length, _HOP) for recording in recordings])


def _fitted(
    name: str, fit: Callable[[Sequence[LabelledRecording]], Detector], training: Sequence[LabelledRecording]
) -> Method:
    slip = labels(training, _HOP) if training else np.empty(0, np.bool_)
    if slip.all() or not slip.any():
        raise InputError(name, "has no training split with slip and static to be fitted to")
    return Method(name, fit(training), f"fitted to {len(slip)} windows")


def _shipped(name: str) -> Method:
    path = shipped(name)
    assert path is not None, "only those that ship are asked for"
    return Method(name, load_detector(name), "ships", load_debounce(path))


def _of_file(path: Path, taken: Collection[str]) -> Method:
    """Named as its detector, or where that name is taken as its file."""
    detector = load_detector(path)
    names = (detector.name, path.stem, *(f"{path.stem}_{number}" for number in range(2, 100)))
    name = next(name for name in names if name not in {*taken, *FITTED})
    return Method(name, detector, path.name, load_debounce(path))

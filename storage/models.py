"""Models on disk: named arrays with a description, never code."""

import hashlib
import json
from collections.abc import Mapping
from math import isclose
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from safetensors import numpy as safetensors

from operators.batch import minute
from operators.debounce import Debounce
from operators.detectors import DETECTORS, TRAINED, Detector
from operators.detectors.weights import ForOneFingertip
from operators.errors import InputError, ParameterError
from operators.fingertip import Fingertip
from storage import files

_SHIPPED: Final = Path(__file__).parent / "trained"
_SUFFIX: Final = ".safetensors"
ALARMS: Final = "alarms"  # entry of a model card: debounce settings by rate of false alarms
LIMIT: Final = 256 * files.MiB  # bytes of a file
UNTUNED: Final = {"consecutive": 2, "release": 10}  # debounce settings without a card


def read_weights(path: Path, data: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Return the arrays of a model and its description, from the content of its file.

    Raises:
        InputError: if the file is damaged, or an array has values that are not finite.
    """
    try:
        weights = safetensors.load(data)
        size = int.from_bytes(data[:8], "little")  # bytes of the header, which has the description
        about = json.loads(data[8 : 8 + size]).get("__metadata__") or {}
    except Exception as error:  # json, numpy and safetensors each raise their own
        reason = str(error).partition("\n")[0]
        reason = f"is damaged or not a {_SUFFIX} file: {reason}; restore a copy"
        raise InputError(str(path), reason) from error
    for name, array in weights.items():
        if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
            reason = f"array {name!r} has values that are not finite: train the model again"
            raise InputError(str(path), reason)
    return weights, about


def save_weights(
    path: str | Path, weights: Mapping[str, NDArray[Any]], about: Mapping[str, str] | None = None
) -> None:
    """Write a model as .safetensors atomically.

    Raises:
        ParameterError: if the path does not end in .safetensors.
        OSError: if it cannot be written.
    """
    path = Path(path)
    if path.suffix != _SUFFIX:
        raise ParameterError("save_weights", "path", str(path), f"a path that ends in {_SUFFIX}")
    path.parent.mkdir(parents=True, exist_ok=True)
    contiguous = {name: np.asarray(array, order="C") for name, array in weights.items()}
    files.put(path, safetensors.save(contiguous, dict(about or {})))


def save_card(path: Path, card: Mapping[str, Any]) -> None:
    """Write the card of a model, a .json of the same name, with a checksum."""
    files.put_checked(path.with_suffix(".json"), card)


def load_detector(name: str | Path) -> Detector:
    """Return a detector by its name, such as tcn or psd, or by its file of weights.

    A card without a fingertip is for a TakkTile at 100 Hz.

    Raises:
        InputError: if there is no such detector, or the file has no weights or does not match its card.
    """
    if make := DETECTORS.get(str(name)):
        return make()
    path = shipped(str(name)) or Path(name)
    if path.suffix != _SUFFIX:
        known = ", ".join(sorted([*DETECTORS, *shipped_names()]))
        raise InputError(str(name), f"is not a detector: give {known} or a {_SUFFIX} file of weights")
    data = files.read(path, LIMIT)
    weights, about = read_weights(path, data)
    card, kind = load_card(path), about.get("detector")
    if "sha256" in card and card["sha256"] != hashlib.sha256(data).hexdigest():
        reason = f"is damaged, or not the model of {path.with_suffix('.json').name}: copy both together"
        raise InputError(str(path), reason)
    if kind not in TRAINED:
        raise InputError(str(name), f"is for detector {kind!r}; known: {', '.join(sorted(TRAINED))}")
    try:
        detector = TRAINED[kind](weights)
    except InputError as error:
        raise InputError(str(name), error.reason) from error
    if isinstance(detector, ForOneFingertip):
        detector.model = Path(name).name
        if "fingertip" in card:
            detector.fingertip = Fingertip.read(card["fingertip"], str(path.with_suffix(".json")))
    return detector


def identify_detector(name: str | Path) -> dict[str, str]:
    """Return the id of a detector, and the sha256 of its weights if it has any, as events state them.

    >>> identify_detector("psd")
    {'id': 'psd'}
    """
    path = shipped(str(name)) or Path(name)
    if str(name) in DETECTORS or path.suffix != _SUFFIX:
        return {"id": str(name)}
    return {"id": path.stem, "sha256": hashlib.sha256(files.read(path, LIMIT)).hexdigest()}


def shipped(name: str) -> Path | None:
    """Return the file of a detector that ships with the package, None if there is none of that name."""
    return shipped_path(name) if name in shipped_names() else None


def shipped_names() -> list[str]:
    """Return the names of the models that ship with the package, the default first.

    >>> shipped_names()[0]
    'tcn'
    """
    return [name for name in TRAINED if shipped_path(name).exists()]


def shipped_path(name: str) -> Path:
    """Return the path at which a model of that name ships with the package."""
    return _SHIPPED / f"{name}.safetensors"


def load_card(path: Path) -> dict[str, Any]:
    """Return the content of a model's card, a .json of the same name; empty if there is none."""
    card = path.with_suffix(".json")
    return files.read_checked(card) if card.exists() else {}


def load_debounce(name: str | Path, false_alarms: float | None = None) -> Debounce:
    """Return the debounce settings of a detector's card; without a card, 2 decisions to start and 10 to end.

    Args:
        name: Built-in detector or weights file.
        false_alarms: Rate of false alarms that the settings must keep, such as `1 / minute`; the card has
            them if `slipflow calibrate` has measured them. None: the settings of the training.

    Raises:
        InputError: if the card is damaged, or the detector was not calibrated for this rate.
    """
    path = shipped(str(name)) or Path(name)
    card = load_card(path) if path.suffix == _SUFFIX else {}
    settings = card.get("debounce") or UNTUNED
    if false_alarms is not None:
        settings = _alarm_settings(str(name), card, false_alarms * minute)
    try:
        return Debounce(**settings)
    except (TypeError, ParameterError) as error:
        raise InputError(str(path.with_suffix(".json")), f"debounce: {error}") from error


def alarm_entries(name: str, card: Mapping[str, Any]) -> dict[float, Mapping[str, Any]]:
    """Return the calibrations in a card by their rate of false alarms per minute.

    Raises:
        InputError: if they are damaged.
    """
    try:
        entries = [each for each in card.get(ALARMS, ()) if each["debounce"]]
        return {float(each["false_alarms_per_min"]): each for each in entries}
    except (ArithmeticError, KeyError, TypeError, ValueError) as error:
        reason = f"its card has damaged settings in {ALARMS!r}: remove them, then calibrate it again"
        raise InputError(name, reason) from error


def _alarm_settings(name: str, card: Mapping[str, Any], per_minute: float) -> Any:
    """Return the settings of a card for a rate of false alarms."""
    found = alarm_entries(name, card)
    for rate, entry in found.items():
        if isclose(rate, per_minute, rel_tol=1e-5):  # calibrate prints six digits
            return entry["debounce"]
    rates = ", ".join(f"{rate:g}/min" for rate in found)
    known = f"calibrated for {rates} only" if found else "not calibrated"
    command = f"slipflow calibrate {name} --on SESSIONS --false-alarms {per_minute:g}/min"
    raise InputError(name, f"is {known}; run `{command}`")

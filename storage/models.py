"""Models on disk: named arrays with some text about them, never code."""

import hashlib
import json
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from safetensors import numpy as safetensors

from operators.debounce import Debounce
from operators.detectors import DETECTORS, TRAINED, Detector
from operators.errors import InputError, ParameterError
from storage import files

_SHIPPED: Final = Path(__file__).parent / "trained"
_DIGEST: Final = "slipflow.sha256"  # of all else that a .safetensors file says; itself knows no checksum
_UNNAMED: Final = "paper_tcn"  # what weights are of that do not say so, as those in .npz
LIMIT: Final = 256 * files.MiB  # of a file, and of what is packed in it


def load_weights(path: str | Path) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """The arrays of a model and what it says of itself, from .safetensors or .npz (which says nothing).

    Raises:
        InputError: if the file is missing, too large or damaged, or an array is not of finite numbers.
    """
    path = Path(path)
    if path.suffix not in _READERS:
        raise InputError(str(path), f"is no model file: these end in {' or '.join(_READERS)}")
    data = files.read(path, LIMIT)
    try:
        weights, about = _READERS[path.suffix](data)
    except Exception as error:  # zipfile, zlib, json, numpy and safetensors each raise their own
        reason = str(error).partition("\n")[0]
        raise InputError(
            str(path), f"is damaged or no {path.suffix} file: {reason}; put a copy back"
        ) from error
    for name, array in weights.items():
        if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
            raise InputError(str(path), f"array {name!r} does not hold finite numbers: train it again")
    return weights, about


def save_weights(
    path: str | Path, weights: Mapping[str, NDArray[Any]], about: Mapping[str, str] | None = None
) -> None:
    """Write a model as .safetensors, whole or not at all.

    Raises:
        ParameterError: if the path does not end in .safetensors.
        OSError: if it cannot be written.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ParameterError("save_weights", "path", str(path), "a path that ends in .safetensors")
    native = {
        name: np.asarray(array, array.dtype.newbyteorder("="), order="C") for name, array in weights.items()
    }
    header, data = _split(safetensors.save(native))
    header["__metadata__"] = dict(sorted((about or {}).items()))
    header["__metadata__"] = {**header["__metadata__"], _DIGEST: _digest(header, data)}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)  # the arrays are aligned
    files.put(path, len(text).to_bytes(8, "little") + text + data)


def save_card(path: Path, card: Mapping[str, Any]) -> None:
    """Write a model's card, the .json beside it, so that damage to it shows.

    Raises:
        OSError: if it cannot be written.
    """
    files.put_checked(path.with_suffix(".json"), card)


def load_detector(name: str | Path) -> Detector:
    """A detector by its name, such as tcn or psd, or the one whose weights are in a file.

    Raises:
        InputError: if there is no such detector, the file does not hold its weights, or they are not those
            that its card tells of.
    """
    if make := DETECTORS.get(str(name)):
        return make()
    path = shipped(str(name)) or Path(name)
    if path.suffix in _READERS:
        weights, about = load_weights(path)
        told = load_card(path).get("sha256")
        if told is not None and told != hashlib.sha256(files.read(path, LIMIT)).hexdigest():
            reason = f"is damaged, or not the model of {path.with_suffix('.json').name}: copy both together"
            raise InputError(str(path), reason)
        kind = about.get("detector", _UNNAMED)
        if kind not in TRAINED:
            raise InputError(str(name), f"is of a detector {kind!r}; known are {', '.join(sorted(TRAINED))}")
        try:
            return TRAINED[kind](weights)
        except InputError as error:
            raise InputError(str(name), error.reason) from error
    known = ", ".join(sorted([*DETECTORS, *filter(shipped, TRAINED)]))
    raise InputError(str(name), f"is no detector: give {known} or a {' or '.join(_READERS)} file of weights")


def identify_detector(name: str | Path) -> dict[str, str]:
    """Which detector that is, for events to tell: its id, and the sha256 of its weights if it has any.

    >>> identify_detector("psd")
    {'id': 'psd'}

    Raises:
        InputError: if the file of its weights cannot be read.
    """
    path = shipped(str(name)) or Path(name)
    if str(name) in DETECTORS or path.suffix not in _READERS:
        return {"id": str(name)}
    return {"id": path.stem, "sha256": hashlib.sha256(files.read(path, LIMIT)).hexdigest()}


def shipped(name: str) -> Path | None:
    """The file of a trained detector that comes with the package; None where there is none of that name."""
    path = _SHIPPED / f"{name}.safetensors"
    return path if name in TRAINED and path.exists() else None


def load_card(path: Path) -> dict[str, Any]:
    """What a model's card, the .json beside it, says; nothing where there is none.

    Raises:
        InputError: if it is damaged.
    """
    place = path.with_suffix(".json")
    return files.read_checked(place) if place.exists() else {}


def load_debounce(name: str | Path) -> Debounce | None:
    """How a detector's card says that its scores are best turned into events; None where it does not.

    Raises:
        InputError: if the card is damaged.
    """
    path = shipped(str(name)) or Path(name)
    settings = load_card(path).get("debounce") if path.suffix in _READERS else None
    if settings is None:
        return None
    try:
        return Debounce(**settings)
    except (TypeError, ParameterError) as error:
        raise InputError(str(path.with_suffix(".json")), f"debounce: {error}") from error


def _read_safetensors(data: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    weights = safetensors.load(data)
    header, arrays = _split(data)
    about = header.get("__metadata__", {})
    if (digest := about.pop(_DIGEST, None)) and digest != _digest(header, arrays):
        raise ValueError("its sha256 is not the one that it names")
    return weights, about


def _split(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The header of a .safetensors file, and its arrays, end to end."""
    start = 8  # bytes, which hold the length of the header
    end = start + int.from_bytes(data[:start], "little")
    return json.loads(data[start:end]), data[end:]


def _digest(header: Mapping[str, Any], arrays: bytes) -> str:
    return files.hash_json({**header, "": hashlib.sha256(arrays).hexdigest()})


def _read_npz(data: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    with zipfile.ZipFile(BytesIO(data)) as archive:
        size = sum(info.file_size for info in archive.infolist())
    if size > LIMIT:
        raise ValueError(f"it unpacks to more than {LIMIT // files.MiB} MiB")
    with np.load(BytesIO(data), allow_pickle=False) as arrays:
        return dict(arrays), {}


_READERS: Final = {".safetensors": _read_safetensors, ".npz": _read_npz}

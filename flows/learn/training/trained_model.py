"""Trained models on disk: weights and a card with their origin and performance."""

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

from numpy.typing import NDArray

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.measures import BALANCED, SHARES, judged
from flows.report.results import estimates, joined
from operators import Debounce
from operators.detectors import Detector
from storage import save_weights
from storage.layout import MANIFEST, SESSIONS
from storage.models import save_card

_SCORES: Final = {"accuracy": SHARES["accuracy %"], "balanced": BALANCED["balanced %"], "f1": SHARES["F1 %"]}
Arrays: TypeAlias = Mapping[str, NDArray[Any]]  # weights as a detector takes them


@dataclass(frozen=True, slots=True)
class Check:
    """Evaluation on the validation split during training."""

    done: int  # steps
    seconds: float
    loss: float  # mean since the last check, nats
    accuracy: float  # on the validation split, %
    balanced: float  # the same, mean of the two classes, %


Progress: TypeAlias = Callable[[int, int, Check | None], object]  # steps done, all steps, new check


@dataclass(frozen=True, slots=True)
class Model:
    """Trained model on disk."""

    path: Path
    card: Mapping[str, Any]  # contents of its .json file

    def report(self) -> str:
        """Return the scores as text."""
        scores: Mapping[str, Mapping[str, float]] = self.card["scores"]
        lines = [f"wrote {self.path} and its card"]
        for part, each in scores.items():
            interval = ""
            if "balanced_low" in each:
                interval = f" ({each['balanced_low']:.1f} to {each['balanced_high']:.1f} over recordings)"
            shown = f"accuracy {each['accuracy']:.2f} %, balanced {each['balanced']:.2f} %{interval}"
            lines.append(f"{part}: {shown}")
        if "before" in scores and not scores["after"]["balanced"] > scores["before"]["balanced"]:
            lines.append("it is NOT better than the model that it was trained from: keep that one")
        return "\n".join(lines)


def label_scores(detector: Detector, recordings: Sequence[LabelledRecording]) -> dict[str, float]:
    """Return accuracy, balanced accuracy and F1 of a detector on the labelled samples, %.

    ``balanced_low`` and ``balanced_high`` are the 95 % interval over recordings, of which three are needed.
    """
    results = [
        judged(
            replace(each, name=str(number), strokes=None),
            each.probabilities(detector),
            Debounce(),
            method="",
        )
        for number, each in enumerate(recordings)
    ]
    found = dict[str, float]()
    for row in estimates(joined(results), _SCORES).iter_rows(named=True):
        found[row["statistic"]] = math.nan if row["value"] is None else row["value"]
        if row["statistic"] == "balanced" and row["low"] is not None:
            found |= {"balanced_low": row["low"], "balanced_high": row["high"]}
    return found


def dataset_digest(dataset: Path) -> str:
    """Return the sha256 of a dataset, or of one of its sessions, for the card of a model.

    It is that of the sessions' manifests, which contain the sha256 of every part.
    """
    digest, folder = hashlib.sha256(), dataset.resolve()
    for manifest in sorted([*folder.glob(MANIFEST), *(folder / SESSIONS).glob(f"*/{MANIFEST}")]):
        digest.update(manifest.parent.name.encode() + b"\0" + manifest.read_bytes())
    return digest.hexdigest()


def learned_from(card: Mapping[str, Any], path: Path) -> bool:
    """Return True if a model's card states that it was trained or chosen on a dataset.

    Args:
        card: Content of the card.
        path: Folder of the dataset, or of one of its sessions, which the card may also state by itself.
    """
    folder = path.resolve()
    folders = [folder, folder.parent.parent] if folder.parent.name == SESSIONS else [folder]
    stated = {each.get("sha256") for each in card.get("data", ())}
    return any(dataset_digest(each) in stated for each in folders)


def provenance(dataset: Path, recordings: Sequence[LabelledRecording]) -> dict[str, Any]:
    """Describe a dataset for the card of a model that was trained on it."""
    by_hand = sum(each.by_hand for each in recordings)
    return {
        "dataset": dataset.resolve().name,
        "sha256": dataset_digest(dataset),
        "recordings": dict(Counter(recording.split for recording in recordings)),
        "samples": sum(map(len, recordings)),
        **({"hand_labels": by_hand} if by_hand else {}),  # samples
    }


def write_model(path: Path, arrays: Arrays, card: Mapping[str, Any]) -> Model:
    """Write a model and its card.

    Args:
        path: Model file, .safetensors; the card has the same name with .json.
        arrays: Weights.
        card: Contents of the card, without the name, sha256 and number of weights of the file.

    Raises:
        OSError: if a file cannot be written.
    """
    save_weights(path, arrays, {"detector": str(card["detector"])})  # one key: the order of more varies
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    size = sum(int(array.size) for array in arrays.values())
    card = {**card, "file": path.name, "sha256": digest, "numbers": size}
    save_card(path, card)
    return Model(path, card)

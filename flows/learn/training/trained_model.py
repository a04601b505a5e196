"""A trained model on disk: its weights, and the card that says where they come from and how good they are."""

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import probabilities
from flows.learn.training.learning_curve import Check
from operators.batch import SLIP, UNKNOWN
from operators.detectors import Detector
from storage import save_weights
from storage.layout import MANIFEST, SESSIONS
from storage.models import save_card

Arrays: TypeAlias = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Model:
    """A trained model on disk."""

    path: Path
    card: Mapping[str, Any]  # what stands in the .json beside it
    curve: Sequence[Check]


def label_scores(detector: Detector, recordings: Sequence[LabelledRecording]) -> dict[str, float]:
    """How right a detector is, as it will be used, on the labelled samples of recordings: shares in %."""
    probability = np.concatenate([probabilities(detector, recording) for recording in recordings])
    label = np.concatenate([recording.label for recording in recordings])
    known = (label != UNKNOWN) & ~np.isnan(probability)
    confusion = Confusion.of(probability[known] > 1 / 2, label[known] == SLIP)
    return {"accuracy": confusion.accuracy, "balanced": confusion.balanced, "f1": confusion.f1}


def provenance(dataset: Path, recordings: Sequence[LabelledRecording]) -> dict[str, Any]:
    """What a dataset was, for the card of a model that was trained on it.

    Its sha256 is that of the manifests of its sessions, and these hold the sha256 of every part.
    """
    digest = hashlib.sha256()
    for manifest in sorted((dataset / SESSIONS).glob(f"*/{MANIFEST}")):
        digest.update(manifest.parent.name.encode() + b"\0" + manifest.read_bytes())
    return {
        "dataset": dataset.resolve().name,
        "sha256": digest.hexdigest(),
        "recordings": dict(Counter(recording.split for recording in recordings)),
        "samples": sum(map(len, recordings)),
    }


def write_model(path: Path, arrays: Arrays, card: Mapping[str, Any], curve: Sequence[Check]) -> Model:
    """Write a model, and beside it its card.

    Args:
        path: The model file, .safetensors; the card ends in .json instead.
        arrays: The weights.
        card: What is known of the model; the file's name, its sha256 and the number of weights are added.
        curve: The course of its training.

    Raises:
        OSError: if a file cannot be written.
    """
    save_weights(path, arrays, {"detector": str(card["detector"])})  # several keys would come in any order
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    size = sum(int(array.size) for array in arrays.values())
    card = {**card, "file": path.name, "sha256": digest, "numbers": size}
    save_card(path, card)
    return Model(path, card, curve)

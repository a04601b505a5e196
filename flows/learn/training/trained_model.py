"""Trained models on disk: weights and a card with their origin and performance."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final, TypeAlias

from numpy.typing import NDArray

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.measures import BALANCED, SHARES, judged
from flows.report.results import estimates, joined
from operators import Debounce
from operators.detectors import Detector
from storage import save_weights
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
    balanced: float | None  # the same, mean of the two classes, %; None: a class is missing


Progress: TypeAlias = Callable[[int, int, Check | None], object]  # steps done, all steps, new check


@dataclass(frozen=True, slots=True)
class Model:
    """Trained model on disk."""

    path: Path
    card: Mapping[str, Any]  # contents of its .json file

    def report(self) -> str:
        """Return the scores as text."""
        scores: Mapping[str, Mapping[str, float | None]] = self.card["scores"]
        lines = [f"wrote {self.path} and its card"]
        for part, each in scores.items():
            known = [(name, each[name]) for name in ("accuracy", "balanced") if each[name] is not None]
            shown = ", ".join(f"{name} {value:.2f} %" for name, value in known)
            lines.append(f"{part}: {shown}")
        before, after = (scores.get(part, {}).get("balanced") for part in ("before", "after"))
        if before is not None and after is not None and after <= before:
            lines.append("it is NOT better than the model that it was trained from: keep that one")
        return "\n".join(lines)


def label_scores(detector: Detector, recordings: Sequence[LabelledRecording]) -> dict[str, float | None]:
    """Return accuracy, balanced accuracy and F1 of a detector on the labelled samples, %.

    None: a class is missing.
    """
    results = (judged(each, each.probabilities(detector), Debounce(), method="") for each in recordings)
    found = estimates(joined(results), _SCORES, draws=0)
    return dict(found.select("statistic", "value").rows())


def learned(card: Mapping[str, Any], recordings: Iterable[LabelledRecording]) -> list[LabelledRecording]:
    """Return the recordings that a model was trained or chosen on, as its card states, under any name."""
    stated = {content for each in card.get("data", ()) for content in str(each.get("learned", "")).split()}
    return [each for each in recordings if each.content in stated]


def repeated(recordings: Sequence[LabelledRecording], parts: Sequence[str]) -> list[str]:
    """Return a line for each recording that appears in two parts, such as splits, of a dataset.

    Recordings whose counts never change are left out, because all of one length are equal.
    """
    first, lines = dict[str, tuple[str, str]](), list[str]()
    for recording, part in zip(recordings, parts, strict=True):
        if (recording.counts == recording.counts[:1]).all():
            continue
        name, other = first.setdefault(recording.content, (recording.name, part))
        if other != part:
            lines.append(f"{recording.name} ({part}) is the same recording as {name} ({other})")
    return lines


def provenance(recordings: Sequence[LabelledRecording]) -> list[dict[str, Any]]:
    """Describe the datasets of recordings for the card of a model; all but test recordings are learned."""
    found = list[dict[str, Any]]()
    for dataset, group in groupby(recordings, key=lambda each: each.dataset):
        parts = list(group)
        found.append(
            {
                "dataset": Path(dataset).resolve().name,
                "recordings": dict(Counter(each.split for each in parts)),
                "samples": sum(map(len, parts)),
                "learned": " ".join(each.content for each in parts if each.split != "test"),
            }
        )
    return found


def write_model(path: Path, arrays: Arrays, card: Mapping[str, Any]) -> Model:
    """Write a model and its card.

    Args:
        path: Model file, .safetensors; the card has the same name with .json.
        arrays: Weights.
        card: Contents of the card, without the name and sha256 of the file.

    Raises:
        OSError: if a file cannot be written.
    """
    save_weights(path, arrays, {"detector": str(card["detector"])})  # one key: the order of more varies
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    card = {**card, "file": path.name, "sha256": digest}
    save_card(path, card)
    return Model(path, card)

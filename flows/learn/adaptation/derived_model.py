"""Models derived from another model, by adaptation or fine-tuning, with a card that states the origin."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from flows.learn.adaptation.adapted import Adapted, adapt
from flows.learn.adaptation.fine_tuning import STEPS, fine_tune
from flows.learn.adaptation.segmentation import segmented
from flows.learn.evaluation.debounce_tuning import tuned_on
from flows.learn.labelled_recordings import (
    LABELS,
    TARGETS,
    LabelledRecording,
    Target,
    hand_label_summary,
    labelled_by,
    load,
    load_unlabelled,
)
from flows.learn.leaks.leak import SEEN, seen_recordings
from flows.learn.training.label_lag import LATEST, relabelled
from flows.learn.training.trained_model import Model, provenance, write_model
from operators import Debounce
from operators.batch import SLIP, STATIC
from operators.checks import check_above, check_between, check_choice
from operators.detectors import Tcn
from operators.errors import InputError, ParameterError
from operators.extras import require_extra
from operators.software import software_version
from storage import load_detector
from storage.models import identify_detector, load_card, shipped

_RULE: Final = "threshold", "consecutive", "release"  # of a debounce


@dataclass(frozen=True, slots=True)
class Derived:
    """Model that was derived from another one, or the decision to keep the other one."""

    parent: str
    adapted: Adapted
    model: Model | None  # None: not better, so nothing was written

    def summary(self) -> dict[str, Any]:
        """Return the scores, and the card without the hashes of recordings, as JSON data."""
        card = {} if self.model is None else dict(self.model.card)
        card.pop(SEEN, None)
        return {
            "path": None if self.model is None else str(self.model.path),
            "kept": self.parent if self.model is None else None,
            "better": self.adapted.better,
            "measure": self.adapted.measure,
            "before": _number(self.adapted.before),
            "after": _number(self.adapted.after),
            **asdict(self.adapted.alignment),
            "card": card,
        }

    def report(self) -> str:
        """Return the result as text."""
        adapted, alignment = self.adapted, self.adapted.alignment
        scores = f"{adapted.measure} on the held-out part {adapted.before:.1f} -> {adapted.after:.1f} %"
        changes = f"time scale {alignment.time_scale}, gain {alignment.gain:g}"
        if self.model is None:
            return f"kept {self.parent}: the new model is not better ({scores}; {changes})"
        worse = "" if adapted.better else "; it is NOT better than its parent"
        return f"wrote {self.model.path} and its card, from {self.parent}: {scores}; {changes}{worse}"


def adapt_model(
    model: str, paths: Sequence[Path], out: Path, *, first: float | None = None, keep_new: bool = False
) -> Derived:
    """Adapt a model to recordings without labels, and write it with a card if it is better.

    Args:
        model: Name of a shipped tcn, or its file.
        paths: Datasets or sessions to adapt to.
        out: Model file, .safetensors.
        first: Time at the start of each recording that is used, s; None: all of it.
        keep_new: Write the model even if it is not better.

    Raises:
        InputError: as `adapt`, or if the model is not a tcn or a recording cannot be read.
        ParameterError: if a parameter is out of range.
        FingertipError: if the fingertip of the recordings differs from that of the model.
        OSError: if the model cannot be written.
    """
    tcn = _parent("adapt", model, out)
    recordings = [replace(each, split="train") for path in paths for each in load_unlabelled(path)]
    if first is not None:
        check_above("adapt", "first", first, 0, "s")
        recordings = [each.piece(slice(round(first * each.fingertip.rate))) for each in recordings]
    adapted = adapt(tcn, recordings)
    segments = [segmented(each.counts, each.fingertip.rate) for each in recordings]
    details = {
        "method": "adapt",
        "first_s": first,
        "contrast": [round(segment.contrast, 3) for segment in segments],
    }
    card = _card(model, tcn, adapted, details, recordings)
    card["debounce"] = _settings(adapted_debounce(adapted, recordings))
    return _write(model, out, adapted, card, keep_new=keep_new)


def adapted_debounce(adapted: Adapted, recordings: Sequence[LabelledRecording]) -> Debounce:
    """Tune the debounce of an adapted network on rest and strokes of recordings that it was adapted to."""
    strokes = [segmented(each.counts, each.fingertip.rate).stroke for each in recordings]
    labels = [np.where(stroke, SLIP, STATIC).astype(np.int8) for stroke in strokes]
    labelled = [replace(each, label=label) for each, label in zip(recordings, labels, strict=True)]
    return tuned_on(labelled, adapted.tcn)


def fine_tune_model(
    model: str,
    datasets: Sequence[Path],
    out: Path,
    *,
    steps: int = STEPS,
    seed: int = 0,
    target: str = TARGETS[0],
    lag: float | None = None,
    labels: str = LABELS[0],
    keep_new: bool = False,
    progress: Callable[[int, int], object] = lambda _done, _all: None,
    log: Callable[[str], object] = lambda _: None,
) -> Derived:
    """Train a model further on labelled datasets, and write it with a card if it is better.

    Recordings of the test split are held out for the comparison; without any, the end of each recording.

    Args:
        model: Name of a shipped tcn, or its file.
        datasets: Labelled datasets.
        out: Model file, .safetensors.
        steps: Number of training steps.
        seed: Seed of crops, augmentation and dropout.
        target: What the network learns, one of `TARGETS`.
        lag: Delay of labels after the signal to which each recording is shifted, s; None: no shift.
        labels: One of `LABELS`: ``hand``, or ``arm`` to ignore labels by hand.
        keep_new: Write the model even if it is not better.
        progress: Called after each step with the numbers of steps done and of all steps.
        log: Receives the number of labels by hand.

    Raises:
        InputError: as `fine_tune`, or if the model is not a tcn or a dataset cannot be read.
        ParameterError: if a parameter is out of range.
        FingertipError: if the fingertip of the recordings differs from that of the model.
        OSError: if the model cannot be written.
    """
    check_choice("train", "target", target, TARGETS)
    if lag is not None:
        check_between("train", "lag", lag, 0, LATEST, unit="s")
    tcn = _parent("train", model, out)
    by_dataset = {
        path: labelled_by(cast("Target", target), load(path, labels=labels), str(path)) for path in datasets
    }
    recordings = list(chain.from_iterable(by_dataset.values()))
    if by_hand := hand_label_summary(recordings):
        log(by_hand)
    held_out = [each for each in recordings if each.split == "test"]
    learned = [each for each in recordings if each.split != "test"]
    shifted = learned if lag is None else relabelled(learned, lag)
    tuned = fine_tune(tcn, shifted, held_out, steps=steps, seed=seed, progress=progress)
    details = {"method": "train --from", "steps": steps, "seed": seed, "label_lag_s": lag}
    card = _card(model, tcn, tuned, details, [replace(each, split="train") for each in learned])
    card |= {"target": target, "data": [provenance(path, each) for path, each in by_dataset.items()]}
    card["debounce"] = _settings(tuned_on(learned, tuned.tcn))
    return _write(model, out, tuned, card, keep_new=keep_new)


def _parent(owner: str, model: str, out: Path) -> Tcn:
    require_extra("train", owner)
    if out.suffix != ".safetensors":
        raise ParameterError(owner, "out", str(out), "a path that ends in .safetensors")
    if not out.parent.is_dir():
        raise InputError(str(out.parent), "is not a folder: create it, or write the model elsewhere")
    detector = load_detector(model)
    if not isinstance(detector, Tcn):
        raise InputError(model, "is not a tcn: only a tcn can be adapted or trained further")
    return detector


def _card(
    model: str,
    parent: Tcn,
    adapted: Adapted,
    details: Mapping[str, Any],
    learned: Sequence[LabelledRecording],
) -> dict[str, Any]:
    """Return the card of the new model; it inherits the target and the debounce of its parent."""
    of_parent = load_card(shipped(model) or Path(model))
    inherited: dict[str, Any] = {
        name: of_parent[name] for name in ("target", "debounce") if name in of_parent
    }
    parts = [
        {"session": each.name, "group": each.group, "seconds": round(len(each) / each.fingertip.rate, 2)}
        for each in learned
    ]
    return {
        "detector": parent.name,
        "fingertip": parent.fingertip.describe(),
        "software": f"slipflow {software_version()}",
        **inherited,
        "parent": identify_detector(model),
        "adaptation": {**details, **asdict(adapted.alignment), "recordings": parts},
        "scores": {
            "held_out": {
                "measure": adapted.measure,
                "before": _number(adapted.before),
                "after": _number(adapted.after),
            }
        },
        SEEN: seen_recordings(learned),
    }


def _settings(rule: Debounce) -> dict[str, Any]:
    return {name: getattr(rule, name) for name in _RULE}


def _write(parent: str, out: Path, adapted: Adapted, card: Mapping[str, Any], *, keep_new: bool) -> Derived:
    written = write_model(out, adapted.tcn.weights, card, ()) if adapted.better or keep_new else None
    return Derived(parent, adapted, written)


def _number(value: float) -> float | None:
    """Return a percentage for JSON; None if it is unknown."""
    return round(value, 2) if np.isfinite(value) else None

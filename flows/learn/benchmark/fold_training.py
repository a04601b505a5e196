"""Training of our network on the training recordings of a fold; the models are kept with their cards."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from flows.learn.benchmark.folds import Fold
from flows.learn.evaluation.debounce_tuning import tuned_on
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.leaks.leak import SEEN, seen_recordings
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import write_model
from operators import Debounce
from operators.detectors import Detector, Tcn
from operators.errors import InputError
from operators.extras import software_version
from storage import load_debounce, load_detector
from storage.files import hash_json

if TYPE_CHECKING:
    from flows.learn.training.training_loop import Progress

_NAME: Final = 16  # hex digits in the name of a model


def trained_tcn(
    fold: Fold, recipe: Recipe, folder: Path, progress: "Progress" = lambda _done, _all, _check: None
) -> tuple[Detector, Debounce]:
    """Train our network, or load the model of the same recordings, labels and settings.

    Args:
        fold: Its training recordings are fitted to; every fifth validates, if enough have slip.
        recipe: Size of the network and course of the training; crops are as short as the shortest recording.
        folder: Folder of the models; created if absent.
        progress: Called after each step.

    Raises:
        InputError: if no training recording has slip, or a card in the folder is damaged.
        ParameterError: if the recordings are shorter than a window.
    """
    fit, validation = fold.parts()
    if not any(each.slip.any() for each in fit):
        raise InputError(fold.name, "none of the other recordings has slip")
    own = replace(recipe, crop=min(recipe.crop, *map(len, fit)))
    fingertip = fit[0].fingertip
    settings: dict[str, Any] = {
        "detector": "tcn",
        "fingertip": fingertip.describe(),
        "target": "arm-speed",
        "data": [_content(fit), _content(validation)],
        "seed": own.seed,
        "recipe": asdict(own),
    }
    path = folder / f"tcn-{hash_json(settings)[:_NAME]}.safetensors"
    if not path.exists():  # its name has the digest of the settings
        _train(path, settings, (fit, validation), own, progress)
    return load_detector(path), load_debounce(path) or Debounce()


def _train(
    path: Path,
    settings: dict[str, Any],
    parts: tuple[Sequence[LabelledRecording], Sequence[LabelledRecording]],
    recipe: Recipe,
    progress: "Progress",
) -> None:
    """Train on the first part; the second chooses checkpoint and debounce."""
    from flows.learn.training.dense_training import train_dense  # noqa: PLC0415 - imports torch

    fit, validation = parts

    trained = train_dense(fit, validation, recipe, progress)
    detector = Tcn(trained.arrays)
    detector.fingertip = fit[0].fingertip
    debounce = tuned_on(validation, detector)
    used = [
        replace(each, split=split)
        for split, part in (("train", fit), ("validation", validation))
        for each in part
    ]
    card = {
        **settings,
        "software": f"slipflow {software_version()}",
        "debounce": {name: getattr(debounce, name) for name in ("threshold", "consecutive", "release")},
        SEEN: seen_recordings(used),
        "curve": [asdict(check) for check in trained.curve],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_model(path, trained.arrays, card)


def _content(recordings: Sequence[LabelledRecording]) -> dict[str, Any]:
    """Return the names of recordings and the sha256 of their counts and labels."""
    digest = hashlib.sha256()
    for each in recordings:
        digest.update(each.counts.tobytes() + each.label.tobytes())
    return {"recordings": [each.name for each in recordings], "sha256": digest.hexdigest()}

"""`slipflow train`: train a detector on datasets, and write the model with its card."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, cast

import numpy as np

from flows.learn.evaluation.debounce_tuning import tuned_on
from flows.learn.labelled_recordings import (
    LABELS,
    TARGETS,
    LabelledRecording,
    Target,
    by_split,
    common_fingertip,
    hand_label_summary,
    labelled_by,
    load,
)
from flows.learn.leaks.leak import SEEN, Leak, seen_recordings, split_leaks
from flows.learn.training.label_lag import LATEST, relabelled
from flows.learn.training.learning_curve import Check
from flows.learn.training.probability_calibration import calibration_of
from flows.learn.training.recipe import PAPER_NETWORKS, PaperRecipe, Recipe
from flows.learn.training.stretching import stretched
from flows.learn.training.trained_model import Arrays, Model, label_scores, provenance, unchanged, write_model
from operators.batch import s
from operators.checks import check_at_least, check_between, check_choice
from operators.detectors import TRAINED, Detector
from operators.detectors.weights import ForOneFingertip
from operators.errors import InputError, ParameterError
from operators.extras import require_extra
from operators.fingertip import TAKKTILE, Fingertip
from operators.software import software_version
from storage import load_weights
from storage.models import save_card

if TYPE_CHECKING:
    from flows.learn.training.training_loop import Trained

Progress: TypeAlias = Callable[
    [str, int, int, Check | None], object
]  # seed, steps done, all steps, new check

OURS: Final = "tcn"
METHODS: Final = (OURS, *PAPER_NETWORKS)


MEANING: Final = (
    "accuracy: correctly classified share of the labelled samples, at probability 0.5; balanced: mean of slip"
    " and static. The validation split selected the checkpoint; the test split was not used in training."
)


@dataclass(frozen=True, slots=True)
class Training:
    """Trained models: one for each seed, the best on validation first."""

    models: Sequence[Model]
    leaks: Sequence[Leak] = ()  # between the splits
    kept: Collection[Path] = ()  # models of an earlier call

    def summary(self) -> dict[str, Any]:
        """Return the leaks, and the cards without the hashes of recordings, as JSON data."""
        cards = [
            {
                "path": str(model.path),
                "kept": model.path in self.kept,
                **{name: value for name, value in model.card.items() if name != SEEN},
            }
            for model in self.models
        ]
        return {"leaks": [leak.json() for leak in self.leaks], "models": cards}

    def report(self) -> str:
        """Return the accuracies as text."""
        lines: list[str] = []
        for model in self.models:
            scores: Mapping[str, Mapping[str, float]] = model.card["scores"]
            shown = ", ".join(
                f"{each['accuracy']:.2f} % on {split}{_interval(each)}" for split, each in scores.items()
            )
            origin = "kept from an earlier run" if model.path in self.kept else "trained now"
            lines.append(f"{model.path}: accuracy {shown} (seed {model.card['seed']}, {origin})")
        for split in ("validation", "test"):
            found = [m.card["scores"][split]["accuracy"] for m in self.models if split in m.card["scores"]]
            if len(found) > 1:
                lines.append(f"{split}: mean {np.mean(found):.2f} %, seed sd {np.std(found, ddof=1):.2f}")
        return "\n".join([*lines, MEANING])


def train(
    datasets: Sequence[Path],
    out: Path,
    *,
    method: str = OURS,
    recipe: Recipe | None = None,
    epochs: int = 20,
    seeds: int = 1,
    target: str = TARGETS[0],
    lag: float | None = None,
    labels: str = LABELS[0],
    resume: bool = False,
    progress: Progress = lambda _part, _done, _all, _check: None,
    warn: Callable[[str], object] = lambda _: None,
) -> Training:
    """Train a detector on the train split of datasets; the validation split selects the best check.

    Args:
        datasets: Folders; each fingertip of each session is a recording.
        out: Model file, .safetensors; its card has the same name with .json. With several seeds, this is
            the best model on validation, and each model is also written as ``OUT-seed0`` and so on.
        method: One of `METHODS`: ``tcn`` or one of the paper's networks.
        recipe: Settings of the tcn.
        epochs: Epochs of the paper's networks.
        seeds: Number of seeds, from the recipe's seed on.
        target: What the network learns, one of `TARGETS`; its card and the checks refer to it.
        lag: Delay of labels after the signal to which each recording is shifted, s; None: no shift.
        labels: One of `LABELS`: ``hand``, or ``arm`` to ignore labels by hand.
        resume: Keep a model of an earlier call if its card states the same data and settings.
        progress: Called with the seed as text, the numbers of steps done and of all steps, and a new
            check or None.
        warn: Receives the number of labels by hand and each leak between the splits, before the training;
            the card lists both as well.

    Raises:
        InputError: if the train extra is missing, a dataset cannot be read, or it lacks the target.
        ParameterError: if a parameter is out of range, or the datasets lack a split or labels to judge by.
        FingertipError: if the recordings have different fingertips, or `method` is for another one.
        OSError: if the model cannot be written.
    """
    recipe = recipe or Recipe()
    _check(out, method, seeds, target, lag)
    chosen = cast("Target", target)
    recordings = {
        dataset: labelled_by(chosen, load(dataset, labels=labels), str(dataset)) for dataset in datasets
    }
    if by_hand := hand_label_summary(chain.from_iterable(recordings.values())):
        warn(by_hand)
    parts = by_split(chain.from_iterable(recordings.values()))
    for split in ("train", "validation"):
        if not parts[split]:
            raise _unusable(datasets, f"five recordings or more, or some with a {split} split")
    leaks = split_leaks(recordings.values())
    for leak in leaks:
        warn(f"leak: {leak.finding}")
    seen = seen_recordings(chain.from_iterable(parts.values()))
    shifted = parts if lag is None else {split: relabelled(found, lag) for split, found in parts.items()}
    learned, judged = (_stretched(found, method, recipe) for found in (shifted, parts))
    _check_judged(datasets, judged)
    fingertip = common_fingertip(chain.from_iterable(parts.values()))
    if method != OURS:
        TAKKTILE.check_fits(method, fingertip)
    about: dict[str, Any] = {
        "detector": method,
        "fingertip": fingertip.describe(),
        "target": target,
        "software": f"slipflow {software_version()}",
        "data": [provenance(dataset, found) for dataset, found in recordings.items()],
        "label_lag_s": lag,
    }
    models, kept = list[Model](), set[Path]()
    for seed in range(recipe.seed, recipe.seed + seeds):
        path = out if seeds == 1 else out.with_stem(f"{out.stem}-seed{seed}")
        own = replace(recipe, seed=seed) if method == OURS else PaperRecipe(epochs=epochs, seed=seed)
        settings = {**about, "seed": seed, "recipe": asdict(own)}
        model = _earlier(path, settings, seen, warn) if resume else None
        if model is None:
            trained = _train(method, {**learned, "train": shifted["train"]}, own, progress)
            calibration, about_it = calibration_of(_detector(method, trained.arrays, fingertip), learned)
            arrays = calibration.fold(trained.arrays)
            results = {**_results(_detector(method, arrays, fingertip), judged), "calibration": about_it}
            curve = [asdict(check) for check in trained.curve]
            found = {"leaks": [leak.json() for leak in leaks], SEEN: seen}
            card = {**settings, **results, **found, "curve": curve}
            model = write_model(path, arrays, card, trained.curve)
        else:
            kept.add(path)
        models.append(model)
    models.sort(key=_merit, reverse=True)
    if seeds > 1:
        first = models[0]
        write_model(out, load_weights(first.path)[0], first.card, first.curve)
    return Training(models, leaks, kept)


def _earlier(
    path: Path, settings: Mapping[str, Any], seen: object, log: Callable[[str], object]
) -> Model | None:
    """Return the model of an earlier call with the same data and settings, with its recordings' hashes."""
    model = unchanged(path, settings)
    if model is None:
        log(f"{path}: trained now, as there is no model with the same data and settings")
        return None
    log(f"{path}: kept from an earlier run with the same data and settings")
    if SEEN not in model.card:  # written by an earlier version
        model = replace(model, card={**model.card, SEEN: seen})
        save_card(path, model.card)
    return model


def _merit(model: Model) -> float:
    """Return the balanced accuracy on validation, %, which compares seeds."""
    balanced: float = model.card["scores"]["validation"]["balanced"]
    return balanced


def _interval(scores: Mapping[str, float]) -> str:
    """Return the interval of the balanced accuracy as text; empty if it is unknown."""
    if "balanced_low" not in scores:
        return ""
    low, high = scores["balanced_low"], scores["balanced_high"]
    return f" (balanced {scores['balanced']:.1f} %, {low:.1f} to {high:.1f} over recordings)"


def _check(out: Path, method: str, seeds: int, target: str, lag: float | None) -> None:
    require_extra("train", "train")
    check_choice("train", "method", method, METHODS)
    check_choice("train", "target", target, TARGETS)
    if out.suffix != ".safetensors":
        raise ParameterError("train", "out", str(out), "a path that ends in .safetensors")
    if not out.parent.is_dir():
        raise InputError(str(out.parent), "is not a folder: create it, or write the model elsewhere")
    check_at_least("train", "seeds", seeds, 1)
    if lag is not None:
        check_between("train", "lag", lag, 0, LATEST, unit="s")


def _check_judged(datasets: Sequence[Path], parts: Mapping[str, Sequence[LabelledRecording]]) -> None:
    """Check that the splits that judge a model have labels after the warm-up: else there is no accuracy."""
    for split in ("validation", "test"):
        if parts[split] and not any(len(recording.known(1)) for recording in parts[split]):
            sampling = parts[split][0].sampling
            warm_up = sampling.warm_up * sampling.period / s
            raise _unusable(datasets, f"{split} recordings with labels after their warm-up of {warm_up:g} s")


def _unusable(datasets: Sequence[Path], needed: str) -> ParameterError:
    return ParameterError("train", "datasets", ", ".join(map(str, datasets)), needed)


def _stretched(
    parts: Mapping[str, Sequence[LabelledRecording]], method: str, recipe: Recipe
) -> dict[str, list[LabelledRecording]]:
    """Return the splits as our network is to be judged on."""
    factor = recipe.stretch if method == OURS else 1
    return {split: [stretched(each, factor) for each in found] for split, found in parts.items()}


def _train(
    method: str,
    parts: Mapping[str, Sequence[LabelledRecording]],
    recipe: Recipe | PaperRecipe,
    progress: Progress,
) -> "Trained":
    """Train one model; `progress` gets the part (the seed) as well."""
    from flows.learn.training.dense_training import train_dense  # noqa: PLC0415 - imports torch
    from flows.learn.training.paper_training import train_windowed  # noqa: PLC0415 - imports torch

    step = partial(progress, f"seed {recipe.seed}")
    train, validation = parts["train"], parts["validation"]
    if isinstance(recipe, Recipe):
        return train_dense(train, validation, recipe, step)
    return train_windowed(method, train, validation, recipe, step)


def _detector(method: str, arrays: Arrays, fingertip: Fingertip) -> Detector:
    """Return a trained detector, for the fingertip of its data."""
    detector = TRAINED[method](arrays)
    assert isinstance(detector, ForOneFingertip), "all trained detectors are"
    detector.fingertip = fingertip
    return detector


def _results(detector: Detector, parts: Mapping[str, Sequence[LabelledRecording]]) -> dict[str, Any]:
    """Return scores and debounce of a trained detector for its card."""
    debounce = tuned_on(parts["validation"], detector)
    judged = {split: parts[split] for split in ("validation", "test") if parts[split]}
    return {
        "scores": {split: label_scores(detector, each) for split, each in judged.items()},
        "debounce": {name: getattr(debounce, name) for name in ("threshold", "consecutive", "release")},
    }

"""`slipflow train`: datasets in; a model file, its card and its curve out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any, Final, TypeAlias

import numpy as np

from flows.learn.evaluation.debounce_tuning import tuned
from flows.learn.evaluation.event_metrics import Slips
from flows.learn.labelled_recordings import LabelledRecording, by_split, load
from flows.learn.scoring import probabilities
from flows.learn.training.label_lag import LATEST, relabelled
from flows.learn.training.learning_curve import Check
from flows.learn.training.paper_training import WINDOWED, Epoch, PaperRecipe, train_windowed
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import Arrays, Model, label_scores, provenance, write_model
from operators.detectors import TRAINED, Detector
from operators.errors import InputError, ParameterError
from storage import load_weights

Progress: TypeAlias = Callable[[str, int, int, "Check | None"], object]  # what, done, in all, check if made

OURS: Final = "tcn"
METHODS: Final = (OURS, *WINDOWED)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What training came to: a model for each seed, the best on validation first."""

    models: Sequence[Model]

    def summary(self) -> dict[str, Any]:
        """The cards, for a program."""
        return {"models": [{"path": str(model.path), **model.card} for model in self.models]}

    def report(self) -> str:
        """The same for a person."""
        lines: list[str] = []
        for model in self.models:
            scores: Mapping[str, Mapping[str, float]] = model.card["scores"]
            told = ", ".join(f"{each['accuracy']:.2f} % on {split}" for split, each in scores.items())
            lines.append(f"{model.path}: accuracy {told} (seed {model.card['seed']})")
        for split in ("validation", "test"):
            found = [m.card["scores"][split]["accuracy"] for m in self.models if split in m.card["scores"]]
            if len(found) > 1:
                lines.append(f"{split}: mean {np.mean(found):.2f} %, seed sd {np.std(found, ddof=1):.2f}")
        return "\n".join(lines)


def train(
    datasets: Sequence[Path],
    out: Path,
    *,
    method: str = OURS,
    recipe: Recipe | None = None,
    epochs: int = 20,
    seeds: int = 1,
    lag: float | None = None,
    progress: Progress = lambda _what, _done, _all, _check: None,
) -> Outcome:
    """Train a detector on the train split of datasets; the validation split chooses, the test split is told.

    An interrupted run of our network goes on where it was when it is started again.

    Args:
        datasets: Their folders; each fingertip of each session is a recording.
        out: The model file, .safetensors; its card stands beside it as .json. Of several seeds it is the best
            on validation, and each is written as ``OUT-seed0`` and so on.
        method: One of `METHODS`: ours, ``tcn``, or one of the paper's.
        recipe: Of our network.
        epochs: Of the paper's networks.
        seeds: How many to train, from the recipe's seed on.
        lag: How long labels are to come after the signal, recording by recording, s; None: as they are.
        progress: Told how far the training of a seed is.

    Raises:
        InputError: if a dataset cannot be read, or torch is not installed.
        ParameterError: on a parameter that cannot be, or datasets without a split that is needed.
        OSError: if the model cannot be written.
    """
    recipe = recipe or Recipe()
    _check(out, method, seeds, lag)
    recordings = {dataset: load(dataset) for dataset in datasets}
    parts = by_split(chain.from_iterable(recordings.values()))
    for split in ("train", "validation"):
        if not parts[split]:
            names = ", ".join(map(str, datasets))
            raise ParameterError(
                "train", "datasets", names, f"five recordings or more, or some with a {split} split"
            )
    learnt = parts if lag is None else {split: relabelled(found, lag) for split, found in parts.items()}
    about: dict[str, Any] = {
        "detector": method,
        "software": f"slipflow {version('slipflow')}",
        "data": [provenance(dataset, found) for dataset, found in recordings.items()],
        "label_lag_s": lag,
    }
    models: list[Model] = []
    for seed in range(recipe.seed, recipe.seed + seeds):
        path = out if seeds == 1 else out.with_stem(f"{out.stem}-seed{seed}")
        own = replace(recipe, seed=seed)
        if method == OURS:
            arrays, curve = _dense(learnt, own, path, progress)
            how: dict[str, Any] = asdict(own)
        else:
            arrays, curve = _windowed(method, learnt, seed, epochs, progress)
            how = {**asdict(PaperRecipe()), "epochs": epochs, "seed": seed}
        detector = TRAINED[method](arrays)
        judged = {
            split: label_scores(detector, parts[split]) for split in ("validation", "test") if parts[split]
        }
        card = {
            **about,
            "seed": seed,
            "recipe": how,
            "scores": judged,
            "debounce": _debounce(detector, parts["validation"]),
            "curve": [asdict(check) for check in curve],
        }
        models.append(write_model(path, arrays, card, curve))
    models.sort(key=lambda model: -model.card["scores"]["validation"]["balanced"])
    if seeds > 1:
        first = models[0]
        write_model(out, load_weights(first.path)[0], first.card, first.curve)
    return Outcome(models)


def _check(out: Path, method: str, seeds: int, lag: float | None) -> None:
    if find_spec("torch") is None:
        raise InputError("training", "needs PyTorch: in the clone, pip install -e '.[train]'")
    if method not in METHODS:
        raise ParameterError("train", "method", method, f"one of {', '.join(METHODS)}")
    if out.suffix != ".safetensors":
        raise ParameterError("train", "out", str(out), "a path that ends in .safetensors")
    if not out.parent.is_dir():
        raise InputError(str(out.parent), "is no folder: make it, or write the model elsewhere")
    if seeds < 1:
        raise ParameterError("train", "seeds", seeds, "at least 1")
    if lag is not None and not 0 <= lag <= LATEST:
        raise ParameterError("train", "lag", lag, f"from 0 to {LATEST} s: labels cannot foresee the signal")


def _dense(
    parts: Mapping[str, Sequence[LabelledRecording]], recipe: Recipe, path: Path, progress: Progress
) -> tuple[Arrays, Sequence[Check]]:
    from flows.learn.training.dense_training import train_dense  # noqa: PLC0415 - imports torch

    def step(done: int, check: Check | None) -> None:
        progress(f"seed {recipe.seed}", done, recipe.steps, check)

    checkpoint = path.with_name(f"{path.stem}.checkpoint.safetensors")
    trained = train_dense(parts["train"], parts["validation"], recipe, checkpoint=checkpoint, progress=step)
    return trained.arrays, trained.curve


def _windowed(
    method: str, parts: Mapping[str, Sequence[LabelledRecording]], seed: int, epochs: int, progress: Progress
) -> tuple[Arrays, Sequence[Check]]:
    began, curve = perf_counter(), list[Check]()

    def epoch(each: Epoch) -> None:
        seconds = perf_counter() - began
        curve.append(Check(each.number, seconds, each.loss, 100 * each.accuracy, 100 * each.balanced))
        progress(f"seed {seed}", each.number, epochs, curve[-1])

    def step(done: int, of: int) -> None:
        progress(f"seed {seed}, epoch {len(curve) + 1}", done, of, None)

    arrays, _ = train_windowed(
        method, parts["train"], parts["validation"], seed=seed, epochs=epochs, progress=epoch, step=step
    )
    return arrays, curve


def _debounce(detector: Detector, validation: Sequence[LabelledRecording]) -> dict[str, float]:
    """The settings that raise events soonest within the usual budget of false alarms."""
    slips = [Slips.labelled(recording) for recording in validation]
    found = tuned([probabilities(detector, recording) for recording in validation], slips)
    return {name: getattr(found, name) for name in ("threshold", "consecutive", "release")}

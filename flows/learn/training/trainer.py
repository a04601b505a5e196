"""`slipflow train`: train a detector on datasets, and write the model with its card."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from scipy.special import expit, logit

from flows.learn.event_metrics import debounce_settings, tuned_on
from flows.learn.labelled_recordings import LabelledRecording, by_split, common_fingertip, load
from flows.learn.training.recipe import REAL_TOUCH, PaperRecipe, Recipe
from flows.learn.training.trained_model import (
    Arrays,
    Model,
    Progress,
    label_scores,
    provenance,
    repeated,
    write_model,
)
from operators.batch import SLIP, UNKNOWN, Flags, Reals
from operators.detectors import TRAINED, Detector, Tcn
from operators.detectors.weights import ForOneFingertip
from operators.errors import InputError, ParameterError
from operators.extras import require_extra, software_version
from operators.fingertip import TAKKTILE, Fingertip
from storage import load_detector
from storage.models import identify_detector, load_card, shipped

Parts: TypeAlias = Mapping[str, Sequence[LabelledRecording]]  # by split

FURTHER_STEPS: Final = 300  # of further training
_FURTHER_CROP: Final = 500  # evaluated samples of a crop of it
_CERTAIN: Final = 1e-12  # distance from 0 and 1 at which logits are cut off
_MIN_SCALE: Final = 0.01  # keeps the order of samples even if validation contradicts the network
_FEW: Final = 5  # sessions, from which on whole ones are held out
_SHARES: Final = {"train": 0.6, "validation": 0.2, "test": 0.2}  # of a recording that is divided in time
_FURTHER_SHARES: Final = {"train": 0.7, "test": 0.3}  # the same, for further training


@dataclass(frozen=True, slots=True)
class Calibration:
    """Linear change of the network's logit: divided by a temperature, then shifted."""

    temperature: float
    bias: float

    @classmethod
    def fitted(cls, probability: Reals, slip: Flags) -> "Calibration":
        """Fit probabilities (k,) to the truth (k,) by maximum likelihood, with the targets of Platt.

        These targets keep the temperature above 0 where the classes are perfectly separated. If a class is
        missing, nothing changes.

        References:
            Platt, "Probabilistic outputs for support vector machines" (1999).
        """
        from scipy.optimize import minimize

        if not slip.any() or slip.all():
            return cls(1.0, 0.0)
        logits: Reals = logit(np.clip(probability, _CERTAIN, 1 - _CERTAIN))
        slips = int(slip.sum())
        target = np.where(slip, (slips + 1) / (slips + 2), 1 / (slip.size - slips + 2))

        def loss(change: Reals) -> tuple[float, Reals]:
            found: Reals = change[0] * logits + change[1]
            error: Reals = expit(found) - target
            value = float(np.mean(np.logaddexp(0, found) - target * found))
            return value, np.array([float(np.mean(error * logits)), float(np.mean(error))])

        best = minimize(
            loss, [1.0, 0.0], jac=True, method="L-BFGS-B", bounds=[(_MIN_SCALE, None), (None, None)]
        )
        return cls(1 / float(best.x[0]), float(best.x[1]))

    def fold(self, arrays: Arrays) -> Arrays:
        """Return weights whose output layer contains the calibration.

        The layer has one output, or two of which the second is slip.
        """
        kernel, bias = arrays["out/kernel"], arrays["out/bias"]
        shifted = bias / self.temperature
        shifted[-1] += self.bias
        changed = {"out/kernel": kernel / self.temperature, "out/bias": shifted}
        return {**arrays, **{name: each.astype(arrays[name].dtype) for name, each in changed.items()}}


def train(
    datasets: Sequence[Path],
    out: Path,
    recipe: Recipe | PaperRecipe,
    *,
    start: str | None = None,
    progress: Progress = lambda _done, _all, _check: None,
    log: Callable[[str], object] = lambda _: None,
) -> Model:
    """Train a detector on the train split of datasets, and write it with its card.

    From random weights, the validation split selects the best check, calibrates the probability and tunes the
    debounce; the test split is only reported. With `start`, the network of a model learns further from all
    recordings that are not in the test split, and keeps the calibration of its probability.

    Args:
        datasets: Folders; each fingertip of each session is a recording.
        out: Model file, .safetensors; its card has the same name with .json.
        recipe: Settings of the training, of a tcn or of one of the paper's networks.
        start: Name of a shipped tcn, or its file, to train further by a `Recipe`; None: random weights.
        progress: Called after each step; the check is None at most of them.
        log: Receives a line if the sessions are few.

    Raises:
        InputError: if the train extra is missing, a dataset cannot be read or a recording is in two splits;
            with `start` if that is no tcn, or the recordings are too short or lack slip or static.
        ParameterError: if a parameter is out of range, `out` is the file of `start`, or the datasets lack a
            split or labels to judge by.
        FingertipError: if the recordings have different fingertips, or the network is for another one.
        OSError: if the model cannot be written.
    """
    require_extra("train", "train")
    if out.suffix != ".safetensors":
        raise ParameterError("train", "out", str(out), "a path that ends in .safetensors")
    if start is not None and (shipped(start) or Path(start)).resolve() == out.resolve():
        must_be = "another file than that of --from: training compares both models"
        raise ParameterError("train", "out", str(out), must_be)
    parent = None if start is None else load_detector(start)
    if not isinstance(parent, Tcn | None):
        raise InputError(str(start), "is not a tcn: only a tcn can be trained further")
    recordings = load(*datasets)
    if twice := repeated(recordings, [each.split for each in recordings]):
        raise InputError("train", f"{twice[0]}: give each recording once")
    fingertip = common_fingertip(recordings)
    about: dict[str, Any] = {
        "detector": recipe.network if isinstance(recipe, PaperRecipe) else Tcn.name,
        "fingertip": fingertip.describe(),
        "software": f"slipflow {software_version()}",
        "data": provenance(recordings),
        "seed": recipe.seed,
        "recipe": asdict(recipe),
    }
    if parent is None:
        parts = by_split(recordings)
        if len({each.session for each in recordings}) < _FEW and not parts["validation"]:
            parts = _in_time(parts["train"], _SHARES) | ({"test": parts["test"]} if parts["test"] else {})
            log("few sessions: each is divided in time, which flatters the model; record five or more")
        arrays, results = _from_random(datasets, about["detector"], parts, recipe, progress)
    else:
        assert isinstance(recipe, Recipe), "the command line trains only a tcn further"
        parent = parent.for_fingertip(fingertip)
        recipe = further(parent, recipe)
        arrays, results = _from_model(parent, recordings, recipe, progress)
        about |= {"detector": parent.name, "parent": identify_detector(str(start)), "recipe": asdict(recipe)}
        about["data"] += load_card(shipped(str(start)) or Path(str(start))).get("data", [])
    return write_model(out, arrays, {**about, **results})


def _in_time(
    recordings: Sequence[LabelledRecording], shares: Mapping[str, float]
) -> dict[str, list[LabelledRecording]]:
    """Divide each recording in time, into consecutive splits of these shares."""
    spans = dict(zip(shares, pairwise(accumulate(shares.values(), initial=0.0)), strict=True))
    pieces = [
        replace(each.piece(slice(round(begin * len(each)), round(end * len(each)))), split=split)
        for each in recordings
        for split, (begin, end) in spans.items()
    ]
    return by_split(pieces)


def _from_random(
    datasets: Sequence[Path], name: str, parts: Parts, recipe: Recipe | PaperRecipe, progress: Progress
) -> tuple[Arrays, dict[str, Any]]:
    """Return the weights of a network that was trained from random ones, and the entries for its card."""
    from flows.learn.training.dense_training import train_dense
    from flows.learn.training.paper_training import train_windowed

    for split in ("train", "validation"):
        if not parts[split]:
            raise _unusable(datasets, f"five sessions or more, or some with a {split} split")
    judged = {split: parts[split] for split in ("validation", "test") if parts[split]}
    for split, recordings in judged.items():  # without labels there is no accuracy
        sampling = recordings[0].sampling
        first = max(sampling.warm_up, recipe.receptive_field - 1)  # sample that has a score
        if not any((recording.known(1) >= first).any() for recording in recordings):
            warm_up = f"{first / sampling.rate:.3g} s"
            raise _unusable(datasets, f"{split} recordings with labels after their warm-up of {warm_up}")
    fingertip = parts["train"][0].fingertip
    if isinstance(recipe, Recipe):
        trained = train_dense(parts["train"], judged["validation"], recipe, progress)
    else:
        TAKKTILE.check_fits(name, fingertip)
        trained = train_windowed(parts["train"], judged["validation"], recipe, progress)
    calibration = calibration_of(_detector(name, trained.arrays, fingertip), judged["validation"])
    arrays = calibration.fold(trained.arrays)
    detector = _detector(name, arrays, fingertip)
    return arrays, {
        "scores": {split: label_scores(detector, each) for split, each in judged.items()},
        "debounce": debounce_settings(tuned_on(judged["validation"], detector)),
        "calibration": asdict(calibration),
        "curve": [asdict(check) for check in trained.curve],
    }


def _from_model(
    parent: Tcn, recordings: Sequence[LabelledRecording], recipe: Recipe, progress: Progress
) -> tuple[Arrays, dict[str, Any]]:
    """Return the weights of a network that was trained further, and the entries for its card.

    All weights learn for a fixed number of steps; two labelled minutes suffice. The recordings that are held
    out choose nothing.
    """
    from flows.learn.training.dense_training import train_dense

    learned = [each for each in recordings if each.split != "test"]
    held_out = [each for each in recordings if each.split == "test"]
    if not learned:
        raise InputError("train", "all recordings are in the test split: give some to learn from")
    if not held_out:
        parts = _in_time(learned, _FURTHER_SHARES)
        learned, held_out = parts["train"], parts["test"]
    if not any((each.known(1) >= parent.length - 1).any() for each in held_out):
        names = ", ".join(each.name for each in held_out)
        raise InputError(names, "is too short to hold out a part: record three sessions or longer ones")
    trained = train_dense(learned, held_out, recipe, progress, parent)
    tcn = _detector(parent.name, trained.arrays, parent.fingertip)
    compared = {"before": parent, "after": tcn}
    return trained.arrays, {
        "scores": {name: label_scores(each, held_out) for name, each in compared.items()},
        "debounce": debounce_settings(tuned_on(learned, tcn)),
        "curve": [asdict(check) for check in trained.curve],
    }


def further(tcn: Tcn, recipe: Recipe) -> Recipe:
    """Return the course of further training of a network: its size, with steps and seed of a recipe."""
    return Recipe(
        filters=tcn.layers[0].kernel.shape[2],
        units=tcn.layers[-1].kernel.shape[1],
        taps=len(tcn.layers[0].kernel),
        dilations=[layer.dilation for layer in tcn.layers[:-3:2]],
        position_scale=float(tcn.position_scale),
        step_scale=float(tcn.step_scale),
        steps=recipe.steps,
        seed=recipe.seed,
        batch=12,
        crop=tcn.length + _FURTHER_CROP,
        rate=2e-3,
        checks=1,
        augmentation=REAL_TOUCH,
    )


def calibration_of(detector: Detector, validation: Sequence[LabelledRecording]) -> Calibration:
    """Fit the calibration of a detector to all labelled samples that have a probability."""
    probability = np.concatenate([each.probabilities(detector) for each in validation])
    label = np.concatenate([each.label for each in validation])
    known = (label != UNKNOWN) & ~np.isnan(probability)
    return Calibration.fitted(probability[known], label[known] == SLIP)


def _unusable(datasets: Sequence[Path], needed: str) -> ParameterError:
    return ParameterError("train", "datasets", ", ".join(map(str, datasets)), needed)


def _detector(name: str, arrays: Arrays, fingertip: Fingertip) -> Detector:
    """Return a trained detector, for the fingertip of its data."""
    detector = TRAINED[name](arrays)
    assert isinstance(detector, ForOneFingertip), "all trained detectors are"
    detector.fingertip = fingertip
    return detector

"""Fine-tuning of a TCN on a few labelled minutes."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from flows.learn.adaptation.adapted import Adapted
from flows.learn.adaptation.alignment import Alignment, aligned, best_alignment, time_scales
from flows.learn.labelled_recordings import LabelledRecording, common_fingertip
from flows.learn.training.recipe import REAL_TOUCH, Recipe
from flows.learn.training.trained_model import label_scores
from operators.batch import SLIP, STATIC, UNKNOWN, Codes, Reals
from operators.detectors import Tcn
from operators.errors import InputError
from operators.extras import require_extra

STEPS: Final = 300
_HELD_OUT: Final = 0.3  # of each recording, if no recording is held out
_TURN: Final = 3  # every third recording is held out, if they are short
_CROP: Final = 500  # evaluated samples of a crop
_FEWEST: Final = 100  # of the crops of short recordings


def fine_tune(
    tcn: Tcn,
    recordings: Sequence[LabelledRecording],
    held_out: Sequence[LabelledRecording] = (),
    *,
    steps: int = STEPS,
    seed: int = 0,
    progress: Callable[[int, int], object] = lambda _done, _all: None,
) -> Adapted:
    """Train a network further on labelled recordings; two minutes suffice.

    The time scale and the gain are chosen at which the network's score agrees best with the labels, unless
    the recordings are hardly longer than the longest window. Then all weights learn for a fixed number of
    steps. The held-out part chooses nothing: it only compares the new network with the old one.

    Args:
        tcn: Trained network.
        recordings: Recordings of the fingertip that the network was trained for.
        held_out: Recordings for the comparison. If empty, the last 30 % of each recording is held out, after
            a gap of one window; if recordings are too short for that, every third one.
        steps: Number of training steps.
        seed: Seed of crops, augmentation and dropout.
        progress: Called after each step with the numbers of steps done and of all steps.

    Raises:
        InputError: if the train extra is missing, or the recordings lack slip or static.
        ParameterError: if the recordings are too short.
        FingertipError: if the fingertip has other cells, another rate or another unit.
    """
    require_extra("train", "train")
    from flows.learn.training.dense_training import train_dense  # noqa: PLC0415 - imports torch

    tcn.check_fingertip(common_fingertip([*recordings, *held_out]))
    short = _are_short(tcn, recordings)
    if short and not held_out:
        recordings, held_out = _divided(recordings)
    learned = [each.piece(slice(round((1 - _HELD_OUT) * len(each)))) for each in recordings]
    if held_out:
        learned = list(recordings)
    found = np.concatenate([each.label for each in learned])
    if not {SLIP, STATIC} <= set(found.tolist()):
        names = ", ".join(each.name for each in learned)
        raise InputError(names, "lacks slip or static samples to learn from: add a recording that has both")
    alignment = Alignment()
    if not short:
        alignment = best_alignment(tcn, [(each.counts, _target(each.label)) for each in learned])
    start = aligned(tcn, alignment)
    judged = list(held_out) or [
        each.piece(slice(len(part) + start.length, None))
        for part, each in zip(learned, recordings, strict=True)
    ]
    recipe = _recipe(start, steps, seed, [*map(len, learned)])
    trained = train_dense(learned, judged, recipe, lambda done, of, _: progress(done, of), start)
    result = type(tcn)(trained.arrays)
    result.fingertip = tcn.fingertip
    before, after = (label_scores(each, judged)["balanced"] for each in (tcn, result))
    return Adapted(result, alignment, before, after, "balanced accuracy")


def _target(label: Codes) -> Reals:
    """Return 1 for slip, 0 for static and NaN for unknown; (n,)."""
    return np.where(label == UNKNOWN, np.nan, label == SLIP)


def _are_short(tcn: Tcn, recordings: Sequence[LabelledRecording]) -> bool:
    """Return True if nothing is left to judge after a gap of one window in the last part of a recording."""
    window = aligned(tcn, Alignment(max(time_scales(tcn)))).length  # samples
    return all(_HELD_OUT * len(each) <= window + each.sampling.warm_up for each in recordings)


def _divided(
    recordings: Sequence[LabelledRecording],
) -> tuple[list[LabelledRecording], list[LabelledRecording]]:
    """Return recordings to learn from, and every third one; both get some with slip if there are two."""
    ordered = sorted(recordings, key=lambda each: not each.slip.any())
    if len(ordered) == 1:
        raise InputError(ordered[0].name, "is too short to hold out a part: add another recording")
    return [each for place, each in enumerate(ordered) if place % _TURN != 1], ordered[1::_TURN]


def _crop(length: int, lengths: Sequence[int]) -> int:
    """Return the samples of a crop: shorter than usual if most recordings are."""
    usual = length + _CROP
    if 2 * sum(each for each in lengths if each >= usual) >= sum(lengths):
        return usual
    return min((each for each in lengths if each >= length + _FEWEST), default=usual)


def _recipe(tcn: Tcn, steps: int, seed: int, lengths: Sequence[int]) -> Recipe:
    """Return the course of the training; the size is that of the network."""
    kernel = tcn.weights["conv0/kernel"]
    taps, _, filters = kernel.shape
    return Recipe(
        filters=filters,
        units=tcn.weights["dense0/bias"].size,
        taps=taps,
        dilations=tcn.weights["dilations"].tolist(),
        position_scale=float(tcn.position_scale),
        step_scale=float(tcn.step_scale),
        steps=steps,
        batch=12,
        crop=_crop(tcn.length, lengths),
        rate=2e-3,
        checks=1,
        seed=seed,
        augmentation=REAL_TOUCH,
    )

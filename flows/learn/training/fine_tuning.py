"""Further training of a TCN on a few labelled minutes of another fingertip.

First the network is aligned with the data. A network that learned strokes of 0.5 s recognises strokes of 1 s
if all dilations double: its receptive field then covers twice the time at the same cost per sample. Counts
that are half as large are recognised if both scales of its features halve.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import LONGEST, REAL_TOUCH, Recipe
from flows.learn.training.trained_model import Check, Progress
from operators.batch import SLIP, STATIC, UNKNOWN, Counts, Reals
from operators.detectors import Tcn
from operators.errors import InputError

TIME_SCALES: Final = (1, 2, 3)
GAINS: Final = (0.25, 1.0, 4.0)
_LARGEST: Final = 8.0  # size of a logit beyond which it says no more
_HELD_OUT: Final = 0.3  # of each recording, if no recording is held out
_CROP: Final = 500  # evaluated samples of a crop
_FEWEST: Final = 100  # of the crops of short recordings


@dataclass(frozen=True, slots=True)
class Alignment:
    """Time scale and gain of other data, relative to the data that a network was trained on."""

    time_scale: int = 1  # duration of strokes; dilations are multiplied by it
    gain: float = 1.0  # counts are multiplied by it


@dataclass(frozen=True, slots=True)
class FineTuned:
    """Network that was trained further."""

    tcn: Tcn
    alignment: Alignment
    curve: Sequence[Check]
    held_out: Sequence[LabelledRecording]  # for the comparison of both networks


def fine_tune(
    tcn: Tcn,
    learned: Sequence[LabelledRecording],
    held_out: Sequence[LabelledRecording],
    recipe: Recipe,
    progress: Progress = lambda _done, _all, _check: None,
) -> FineTuned:
    """Train a network further on labelled recordings; two minutes suffice.

    All weights learn for a fixed number of steps. The held-out part chooses nothing: it only compares the new
    network with the old one.

    Args:
        tcn: Trained network, for the fingertip of the recordings.
        learned: Recordings to learn from.
        held_out: Recordings for the comparison. If empty, the last 30 % of each recording, after a gap of one
            window.
        recipe: Its seed and steps are used; size, rate and augmentation are those of `further`.
        progress: Called after each step.

    Raises:
        InputError: if the recordings lack slip or static, or are too short to hold out a part.
        ParameterError: if no recording is as long as a crop.
    """
    from flows.learn.training.dense_training import train_dense

    alignment = best_alignment(tcn, learned)
    start = aligned(tcn, alignment)
    if not held_out:
        cut = [round((1 - _HELD_OUT) * len(each)) for each in learned]
        held_out = [
            each.piece(slice(end + start.length, None)) for each, end in zip(learned, cut, strict=True)
        ]
        learned = [each.piece(slice(end)) for each, end in zip(learned, cut, strict=True)]
    held_out = [each for each in held_out if len(each.known(1))]
    if not held_out:
        names = ", ".join(each.name for each in learned)
        raise InputError(names, "is too short to hold out a part: record three sessions or longer ones")
    found = np.concatenate([each.label for each in learned])
    if not {SLIP, STATIC} <= set(found.tolist()):
        names = ", ".join(each.name for each in learned)
        raise InputError(names, "lacks slip or static samples to learn from: add a recording that has both")
    trained = train_dense(learned, held_out, further(start, recipe, [*map(len, learned)]), progress, start)
    result = type(tcn)(trained.arrays)
    result.fingertip = tcn.fingertip
    return FineTuned(result, alignment, trained.curve, held_out)


def further(tcn: Tcn, recipe: Recipe, lengths: Sequence[int]) -> Recipe:
    """Return the course of further training on recordings of these lengths; the size is that of a network."""
    usual = tcn.length + _CROP
    crop = usual
    if 2 * sum(each for each in lengths if each >= usual) < sum(lengths):  # most recordings are shorter
        crop = min((each for each in lengths if each >= tcn.length + _FEWEST), default=usual)
    return replace(
        Recipe.of(tcn),
        steps=recipe.steps,
        seed=recipe.seed,
        batch=12,
        crop=crop,
        rate=2e-3,
        checks=1,
        augmentation=REAL_TOUCH,
    )


def aligned(tcn: Tcn, alignment: Alignment) -> Tcn:
    """Return the network for data with another time scale and gain, for the same fingertip.

    >>> from storage import load_detector
    >>> aligned(load_detector("tcn"), Alignment(time_scale=2)).length
    198
    """
    weights = dict(tcn.weights)
    weights["dilations"] = weights["dilations"] * alignment.time_scale
    for name in ("position_scale", "step_scale"):
        weights[name] = (weights[name] / alignment.gain).astype(np.float32)
    result = type(tcn)(weights)
    result.fingertip = tcn.fingertip
    return result


def best_alignment(tcn: Tcn, recordings: Sequence[LabelledRecording]) -> Alignment:
    """Return the alignment at which the logit correlates best with the labels.

    All alignments are compared on the same samples, those after the longest window. Recordings that are
    hardly longer do not count; without any other, the network stays as it is.
    """
    candidates = [Alignment(*each) for each in product(TIME_SCALES, GAINS)]
    networks = [(each, aligned(tcn, each)) for each in candidates]
    networks = [(each, network) for each, network in networks if network.length <= max(LONGEST, tcn.length)]
    first = max(network.length for _, network in networks) - 1
    usable = [each for each in recordings if len(each) > 2 * first and (each.label[first:] != UNKNOWN).any()]
    if not usable:
        return Alignment()
    label = np.concatenate([each.label[first:] for each in usable])
    known = label != UNKNOWN
    slip = label[known] == SLIP
    if slip.all() or not slip.any():
        return Alignment()

    def agreement(network: Tcn) -> float:
        logit = np.concatenate([_logits(network, each.counts)[first:] for each in usable])[known]
        return float(np.corrcoef(logit, slip)[0, 1]) if logit.std() else 0.0

    return max(networks, key=lambda each: agreement(each[1]))[0]


def _logits(tcn: Tcn, counts: Counts) -> Reals:
    """Return the logit of slip at each sample of counts (n, cells), limited to +-8; (n,)."""
    probability = tcn.stream().push(counts[:, None])[:, 0]
    with np.errstate(divide="ignore"):
        logit: Reals = np.log(probability) - np.log1p(-probability)
    return np.clip(logit, -_LARGEST, _LARGEST)

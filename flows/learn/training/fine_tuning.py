"""Further training of a TCN on a few labelled minutes of another fingertip.

First the network is stretched to the pace of the data. A network that learned strokes of 0.5 s recognises
strokes of 1 s if all dilations double: its receptive field then covers twice the time at the same cost per
sample.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import REAL_TOUCH, Recipe
from flows.learn.training.trained_model import Progress
from operators.batch import SLIP, STATIC, UNKNOWN
from operators.detectors import Tcn
from operators.errors import InputError

if TYPE_CHECKING:
    from flows.learn.training.training_loop import Trained

TIME_SCALES: Final = (1, 2, 3)
_LONGEST: Final = 640  # samples, receptive field of a stretched network
_CROP: Final = 500  # evaluated samples of a crop
_FEWEST: Final = 100  # of the crops of short recordings


def fine_tune(
    tcn: Tcn,
    learned: Sequence[LabelledRecording],
    held_out: Sequence[LabelledRecording],
    recipe: Recipe,
    progress: Progress = lambda _done, _all, _check: None,
) -> "Trained":
    """Train a network further on labelled recordings; two minutes suffice.

    All weights learn for a fixed number of steps. The held-out recordings choose nothing.

    Args:
        tcn: Trained network, for the fingertip and the pace (`best_time_scale`) of the recordings.
        learned: Recordings to learn from.
        held_out: Recordings for the check at the end.
        recipe: Its seed and steps are used; size, rate and augmentation are those of `further`.
        progress: Called after each step.

    Raises:
        InputError: if the recordings to learn from lack slip or static.
        ParameterError: if no recording is as long as a crop.
    """
    from flows.learn.training.dense_training import train_dense

    if not {SLIP, STATIC} <= set(np.concatenate([each.label for each in learned]).tolist()):
        names = ", ".join(each.name for each in learned)
        raise InputError(names, "lacks slip or static samples to learn from: add a recording that has both")
    return train_dense(learned, held_out, further(tcn, recipe, [*map(len, learned)]), progress, tcn)


def further(tcn: Tcn, recipe: Recipe, lengths: Sequence[int]) -> Recipe:
    """Return the course of further training on recordings of these lengths; the size is that of a network."""
    crop = usual = tcn.length + _CROP
    if 2 * sum(each for each in lengths if each >= usual) < sum(lengths):  # most recordings are shorter
        crop = min((each for each in lengths if each >= tcn.length + _FEWEST), default=usual)
    return Recipe(
        filters=tcn.layers[0].kernel.shape[2],
        units=tcn.layers[-1].kernel.shape[1],
        taps=len(tcn.layers[0].kernel),
        dilations=tcn.weights["dilations"].tolist(),
        position_scale=float(tcn.position_scale),
        step_scale=float(tcn.step_scale),
        steps=recipe.steps,
        seed=recipe.seed,
        batch=12,
        crop=crop,
        rate=2e-3,
        checks=1,
        augmentation=REAL_TOUCH,
    )


def stretched(tcn: Tcn, time_scale: int) -> Tcn:
    """Return the network for strokes that last `time_scale` times as long, for the same fingertip.

    >>> from storage import load_detector
    >>> tcn = load_detector("tcn")
    >>> stretched(tcn, 2).length == 2 * tcn.length - 2
    True
    """
    result = type(tcn)({**tcn.weights, "dilations": tcn.weights["dilations"] * time_scale})
    result.fingertip = tcn.fingertip
    return result


def best_time_scale(tcn: Tcn, recordings: Sequence[LabelledRecording]) -> int:
    """Return the time scale at which the probability correlates best with the labels.

    All are compared on the same samples, those after the longest window. Recordings that are hardly longer
    do not count; without any other, the network stays as it is.
    """
    networks = {scale: stretched(tcn, scale) for scale in TIME_SCALES}
    networks = {scale: each for scale, each in networks.items() if each.length <= max(_LONGEST, tcn.length)}
    first = max(network.length for network in networks.values()) - 1
    usable = [each for each in recordings if len(each) > 2 * first]
    label = np.concatenate([np.empty(0, np.int8), *(each.label[first:] for each in usable)])
    known = label != UNKNOWN
    slip = label[known] == SLIP
    if slip.all() or not slip.any():
        return 1

    def agreement(scale: int) -> float:
        streamed = [np.nan_to_num(each.probabilities(networks[scale])[first:], nan=0.5) for each in usable]
        probability = np.concatenate(streamed)[known]
        return float(np.corrcoef(probability, slip)[0, 1]) if probability.std() else 0.0

    return max(networks, key=agreement)

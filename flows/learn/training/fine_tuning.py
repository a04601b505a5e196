"""Further training of a TCN on a few labelled minutes of another fingertip."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import REAL_TOUCH, Recipe
from flows.learn.training.trained_model import Progress
from operators.batch import SLIP, STATIC
from operators.detectors import Tcn
from operators.errors import InputError

if TYPE_CHECKING:
    from flows.learn.training.training_loop import Trained

_CROP: Final = 500  # evaluated samples of a crop


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
        tcn: Trained network, for the fingertip of the recordings.
        learned: Recordings to learn from.
        held_out: Recordings for the check at the end.
        recipe: Its seed and steps are used; size, rate and augmentation are those of `further`.
        progress: Called after each step.

    Raises:
        InputError: if the recordings to learn from lack slip or static.
    """
    from flows.learn.training.dense_training import train_dense

    if not {SLIP, STATIC} <= set(np.concatenate([each.label for each in learned]).tolist()):
        names = ", ".join(each.name for each in learned)
        raise InputError(names, "lacks slip or static samples to learn from: add a recording that has both")
    return train_dense(learned, held_out, further(tcn, recipe), progress, tcn)


def further(tcn: Tcn, recipe: Recipe) -> Recipe:
    """Return the course of further training; the size is that of a network."""
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
        crop=tcn.length + _CROP,
        rate=2e-3,
        checks=1,
        augmentation=REAL_TOUCH,
    )

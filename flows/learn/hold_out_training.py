"""Methods that are fitted to all surfaces or objects of a dataset but the one that is held out."""

from collections.abc import Collection
from dataclasses import replace
from functools import partial
from typing import Final

from flows.learn.evaluation.baselines import STROKES
from flows.learn.evaluation.folds import Fold
from flows.learn.evaluation.methods import Candidate, Method, fitted_baseline
from flows.learn.training.recipe import REAL_TOUCH, Recipe
from operators.detectors import Tcn
from operators.errors import InputError
from operators.extras import require_extra

TRAINED: Final = "tcn, trained"
SHORT: Final = Recipe(steps=400, augmentation=REAL_TOUCH)
_HOP: Final = 2  # samples at 100 Hz between the windows that baselines are fitted to


def learners(names: Collection[str] = (), recipe: Recipe = SHORT) -> list[Candidate]:
    """Return the methods that learn from a fold.

    Args:
        names: Only these: logistic, gradient_boosting and tcn; empty: all.
        recipe: Size and training of the network.
    """
    found = {
        name: Candidate(name, partial(fitted_baseline, name, features=STROKES, hop=_HOP))
        for name in ("logistic", "gradient_boosting")
    }
    found["tcn"] = Candidate(TRAINED, partial(_trained_tcn, recipe))
    return [each for name, each in found.items() if not names or name in names]


def _trained_tcn(recipe: Recipe, fold: Fold) -> Method:
    """Train our network; crops are as short as the shortest recording."""
    require_extra("train", TRAINED)
    from flows.learn.training.dense_training import train_dense

    if not any(each.slip.any() for each in fold.train):
        raise InputError(TRAINED, "none of the recordings to learn from has slip")
    own = replace(recipe, crop=min(recipe.crop, *map(len, fold.train)))
    detector = Tcn(train_dense(fold.train, fold.validation, own).arrays)
    detector.fingertip = fold.train[0].fingertip
    return Method(TRAINED, detector)

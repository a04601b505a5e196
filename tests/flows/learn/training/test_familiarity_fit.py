from dataclasses import replace

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.dense_training import train_dense
from flows.learn.training.familiarity_fit import SHARE, distances, familiarity_of
from flows.learn.training.recipe import Recipe
from operators.detectors import Tcn

SMALL = Recipe(filters=6, units=4, steps=60, batch=4, crop=256, checks=3, rate=2e-2)


@pytest.fixture(scope="module")
def tcn(recordings: list[LabelledRecording]) -> Tcn:
    arrays = train_dense(recordings[:4], recordings[4:], SMALL).arrays
    return Tcn({**arrays, **familiarity_of(Tcn(arrays), recordings[:4], recordings[4:])})


def test_one_percent_of_validation_is_beyond_the_limit(tcn: Tcn, recordings: list[LabelledRecording]) -> None:
    familiarity = tcn.heads.familiarity
    assert familiarity is not None
    found = np.concatenate([distances(tcn, familiarity, each) for each in recordings[4:]])
    assert (found > familiarity.limit).mean() == pytest.approx(SHARE, abs=2e-3)


def test_input_that_was_never_seen_is_far(tcn: Tcn, recordings: list[LabelledRecording]) -> None:
    familiarity = tcn.heads.familiarity
    assert familiarity is not None
    random = np.random.default_rng(0).normal(0, 2000, recordings[5].counts.shape)
    other = replace(recordings[5], counts=random.astype(np.int16))
    assert np.median(distances(tcn, familiarity, other)) > familiarity.limit

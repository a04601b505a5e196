from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.dense_training import DenseTcn, train_dense
from flows.learn.training.recipe import Recipe
from operators import InputError, ParameterError
from operators.detectors import Tcn

SMALL = Recipe(filters=4, units=4, steps=60, batch=4, crop=256, checks=6, rate=2e-2)


def test_the_same_seed_gives_the_same_weights_and_another_gives_others(
    recordings: list[LabelledRecording],
) -> None:
    recipe = replace(SMALL, steps=10)
    first, again, other = (
        train_dense(recordings[:4], recordings[4:], replace(recipe, seed=seed)).arrays for seed in (0, 0, 1)
    )
    for name, array in first.items():
        np.testing.assert_array_equal(array, again[name])
    assert not np.array_equal(first["conv0/kernel"], other["conv0/kernel"])


@pytest.mark.parametrize("label", [0, 1, -1])
def test_recordings_of_one_class_are_refused(recordings: list[LabelledRecording], label: int) -> None:
    flat = [replace(recording, label=np.full_like(recording.label, label)) for recording in recordings[:4]]
    with pytest.raises(InputError, match="of static to learn from: both are needed"):
        train_dense(flat, recordings[4:], SMALL)
    unknown = replace(recordings[4], label=np.full_like(recordings[4].label, -1))
    for validation in ([], [unknown]):
        with pytest.raises(ParameterError, match="must be recordings with labels"):
            train_dense(recordings[:4], validation, SMALL)


def test_the_beginning_of_a_recording_is_learned(recordings: list[LabelledRecording]) -> None:
    first = [each.piece(slice(0, SMALL.receptive_field - 1)) for each in recordings]  # without a full window
    assert max(each.balanced or 0 for each in train_dense(first[:4], first[4:], SMALL).curve) > 90


def test_samples_without_a_label_do_not_count(recordings: list[LabelledRecording]) -> None:
    known = np.arange(len(recordings[0])) % 5 == 0  # as static the others would outnumber the slip
    masked = [replace(each, label=np.where(known, each.label, -1)) for each in recordings[:4]]
    assert max(each.balanced or 0 for each in train_dense(masked, recordings[4:], SMALL).curve) > 90


def test_the_detector_made_of_the_weights_is_the_network(recordings: list[LabelledRecording]) -> None:
    cast("Any", torch).manual_seed(0)
    network = DenseTcn(recipe := Recipe(filters=5))
    counts = torch.as_tensor(recordings[0].counts).to(torch.float32).T[None]
    for _ in range(3):  # so that the norms have seen something
        network(counts)
    network.eval()
    with torch.no_grad():
        dense = torch.sigmoid(network(counts))[0].numpy()
    tcn = Tcn(network.arrays())
    assert tcn.length == recipe.receptive_field
    streamed = recordings[0].probabilities(tcn)
    np.testing.assert_allclose(streamed[tcn.length - 1 :], dense[tcn.length - 1 :], atol=1e-5)


def test_the_weights_of_a_check_do_not_change_in_later_steps() -> None:
    network = DenseTcn(Recipe(filters=5))
    kept = network.arrays()
    before = {name: array.copy() for name, array in kept.items()}
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(1)
    for name, array in kept.items():
        np.testing.assert_array_equal(array, before[name])

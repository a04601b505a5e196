from dataclasses import replace

import numpy as np
import torch

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.augmentation import augmented
from flows.learn.training.dense_training import train_dense
from flows.learn.training.recipe import Augmentation, Recipe
from flows.learn.training.tcn_features import features, velocities
from flows.learn.training.velocity_head import VelocityHead, velocity_loss
from flows.learn.training.velocity_scores import velocity_scores
from operators.batch import SLIP
from operators.detectors import Tcn

NOTHING = Augmentation(flip=0.0, gain=0.0, load=0.0, noise=0.0, dead=0.0)
SMALL = Recipe(filters=6, units=4, steps=150, batch=8, crop=256, checks=3, rate=2e-2, augmentation=NOTHING)


def directed(recording: LabelledRecording, seed: int) -> LabelledRecording:
    """Add a side to the counts of slips, and the velocity towards it."""
    slip = recording.label == SLIP
    slips = np.cumsum(np.diff(slip, prepend=False))  # number of the slip or of the pause
    sign = np.random.default_rng(seed).choice([-1.0, 1.0], slips[-1] + 1)[slips]
    counts = recording.counts.copy()
    counts[slip, :3] += (200 * sign[slip, None]).astype(np.int16)
    velocity = np.where(slip[:, None], np.column_stack([60 * sign, 0 * sign]), np.nan)
    return replace(recording, counts=counts, velocity=velocity, sliding=recording.label)


def test_the_head_learns_the_direction_and_only_where_it_is_known(
    recordings: list[LabelledRecording],
) -> None:
    known = [directed(recording, seed) for seed, recording in enumerate(recordings)]
    tcn = Tcn(train_dense(known[:4], known[4:], SMALL).arrays)
    found = velocity_scores(tcn, known[4:])
    assert found is not None
    assert found.direction > 90
    assert velocity_scores(tcn, recordings) is None
    assert velocity_scores(Tcn(train_dense(recordings[:4], recordings[4:], SMALL).arrays), known) is None


def test_the_weights_give_millimetres_per_second(recordings: list[LabelledRecording]) -> None:
    recipe = replace(SMALL, steps=2, checks=1)
    tcn = Tcn(train_dense([directed(each, 0) for each in recordings[:4]], recordings[4:], recipe).arrays)
    head = VelocityHead(6)
    arrays = {
        f"layers.{number}.{name}": torch.as_tensor(array.copy())
        for number, layer in enumerate(tcn.heads.velocity)
        for name, array in (("weight", layer.kernel[0].T[..., None]), ("bias", layer.bias))
    }
    head.load_state_dict(arrays)
    counts = recordings[0].counts
    hidden = torch.as_tensor(features(tcn, counts), dtype=torch.float32).T[None]
    with torch.no_grad():
        np.testing.assert_allclose(velocities(tcn, counts), head(hidden)[0].T.numpy(), rtol=1e-3, atol=1e-3)


def test_a_flip_turns_the_velocity() -> None:
    generator = torch.Generator()
    _, signs = augmented(torch.zeros(200, 6, 5), replace(NOTHING, flip=1.0), generator)
    assert (signs == -1).all()
    _, signs = augmented(torch.zeros(200, 6, 5), replace(NOTHING, flip=0.5), generator)
    assert len(np.unique(signs.numpy(), axis=0)) == 4


def test_the_loss_ignores_unknown_velocities_and_is_least_at_the_true_deviation() -> None:
    true = torch.tensor([[[60.0, -30.0], [float("nan"), float("nan")]]])
    perfect = torch.tensor([[[1.0, 9.0], [-0.5, 9.0], [-2.0, 9.0], [-2.0, 9.0]]])
    assert velocity_loss(perfect, true) == -2
    assert velocity_loss(perfect + torch.tensor([[0.5], [0.5], [0], [0]]), true) > 0
    assert velocity_loss(perfect, torch.full((1, 2, 2), float("nan"))) == 0

from typing import Any, cast

import numpy as np
import pytest
import torch

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.augmentation import (
    GAIN,
    MIRROR_X,
    MIRROR_Y,
    SPREAD,
    augmented,
    stretched,
    stretches,
)
from flows.learn.training.recipe import Augmentation
from flows.learn.training.training_crops import Crops

NOTHING = Augmentation(flip=0.0, gain=0.0, load=0.0, noise=0.0, dead=0.0)
COUNTS = torch.arange(8 * 6 * 50, dtype=torch.float32).reshape(8, 6, 50)


def _augmented(how: Augmentation, counts: torch.Tensor = COUNTS) -> torch.Tensor:
    generator = torch.Generator()
    cast("Any", generator).manual_seed(1)
    return augmented(counts, how, generator)


def _only(**chances: float) -> Augmentation:
    return Augmentation(**{"flip": 0.0, "gain": 0.0, "load": 0.0, "noise": 0.0, "dead": 0.0} | chances)  # type: ignore[arg-type]


@pytest.mark.parametrize("mirror", [MIRROR_X, MIRROR_Y])
def test_a_mirror_undoes_itself_and_keeps_the_middle_cells_in_place(mirror: tuple[int, ...]) -> None:
    assert [mirror[cell] for cell in mirror] == list(range(6))
    assert {mirror[1], mirror[4]} == {1, 4}


def test_flips_of_all_crops_turn_the_pad_by_half() -> None:
    turned = _augmented(_only(flip=1.0))
    assert torch.equal(turned, COUNTS[:, (3, 4, 5, 0, 1, 2)])


def test_dead_cells_are_one_or_two_and_read_0() -> None:
    dead = (_augmented(_only(dead=1.0), COUNTS + 1) == 0).numpy().all(axis=2).sum(axis=1)
    assert set(dead) == {1, 2}


def test_noise_is_within_its_range() -> None:
    flat = torch.zeros(64, 6, 400)
    spread = _augmented(
        Augmentation(0.0, 0.0, 0.0, 0.0, noise=1.0, noise_range=(5.0, 20.0), dead=0.0), flat
    ).std(dim=(1, 2))
    assert spread.min() > 4.5
    assert spread.max() < 21.5


def test_a_gain_multiplies_each_cell_by_one_factor() -> None:
    counts = torch.full((4, 6, 50), 1000.0)
    varied = _augmented(_only(gain=1.0), counts).numpy()
    assert (varied == varied[..., :1]).all()
    assert len(np.unique(varied[..., 0])) > 12


def test_a_change_of_load_is_slow() -> None:
    moved = _augmented(_only(load=1.0), torch.zeros(16, 6, 400)).numpy()
    assert np.abs(moved).max() > 10
    assert (
        np.abs(np.diff(moved, axis=2)).max() < 0.13 * np.abs(moved).max() * 2
    )  # 2 Hz at 100 Hz, and rounding


def test_counts_stay_whole() -> None:
    varied = _augmented(Augmentation(gain=1.0, noise=1.0, load=1.0))
    assert torch.equal(varied, varied.round())


@pytest.fixture
def ramp() -> LabelledRecording:
    counts = np.arange(100, dtype=np.int16)[:, None] * np.ones(6, np.int16)
    return LabelledRecording(counts, (np.arange(100) >= 50).astype(np.int8))


def test_a_stretched_recording_is_longer_with_its_labels_in_place(ramp: LabelledRecording) -> None:
    found = stretched(ramp, 2)
    assert len(found) == len(found.counts) == 199
    gain = (GAIN[0] * GAIN[1]) ** 0.5
    np.testing.assert_allclose(found.counts[:, 0], np.arange(199) / 2 * gain, atol=0.51)
    assert abs(int(found.label.argmax()) - 100) <= 1


def test_crops_end_at_the_same_sample_whatever_their_stretch(ramp: LabelledRecording) -> None:
    crops = Crops([ramp, ramp], 41, torch.device("cpu"))
    counts, rows = crops.stretched(torch.tensor([10, 10]), torch.tensor([1.0, 2.0]))
    np.testing.assert_array_equal(counts[0, 3].numpy(), np.arange(10, 51))
    np.testing.assert_array_equal(rows[0].numpy(), np.arange(10, 51))
    np.testing.assert_array_equal(counts[1, 3].numpy(), 30 + np.arange(41) / 2)
    assert rows[1, 40] == 50


def test_stretches_and_gains_stay_in_their_ranges() -> None:
    factor, gain = stretches(1000, 2, torch.Generator())
    assert 2 / SPREAD <= factor.min() < 1.6
    assert 2.5 < factor.max() <= 2 * SPREAD
    assert GAIN[0] <= gain.min() < gain.max() <= GAIN[1]
    assert (stretches(3, 1, torch.Generator())[0] == 1).all()

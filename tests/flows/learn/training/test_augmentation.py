from typing import Any, cast

import numpy as np
import torch

from flows.learn.training.recipe import PAPER_TOUCH, Augmentation
from flows.learn.training.training_loop import augmented

COUNTS = torch.arange(8 * 6 * 50, dtype=torch.float32).reshape(8, 6, 50)


def _augmented(how: Augmentation, counts: torch.Tensor = COUNTS) -> torch.Tensor:
    generator = torch.Generator()
    cast("Any", generator).manual_seed(1)
    return augmented(counts, how, generator)


def _only(**chances: float) -> Augmentation:
    return Augmentation(**{"flip": 0.0, "gain": 0.0, "load": 0.0, "noise": 0.0, "dead": 0.0} | chances)  # type: ignore[arg-type]


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


def test_the_papers_networks_see_each_symmetry_of_the_pad_equally_often_with_noise() -> None:
    cells = 100 * torch.arange(6).expand(4000, 100, 6).float().transpose(1, 2)
    counts = _augmented(PAPER_TOUCH, cells).numpy()
    cell = np.rint(counts / 100)
    assert (cell == cell[:, :, :1]).all()  # a window moves as a whole
    pad = np.array([[5, 4, 3], [0, 1, 2]])  # as it lies
    for symmetry in (pad, pad[:, ::-1], pad[::-1], pad[::-1, ::-1]):
        assert 0.22 < (cell[:, pad.ravel(), 0] == symmetry.ravel()).all(axis=1).mean() < 0.28
    assert 0.49 < (counts - 100 * cell).std() < 0.51  # counts

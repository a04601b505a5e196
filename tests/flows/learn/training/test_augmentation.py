from typing import Any, cast

import numpy as np
import pytest
import torch

from flows.learn.training.augmentation import MIRROR_X, MIRROR_Y, augmented
from flows.learn.training.recipe import Augmentation

NOTHING = Augmentation(flip=0.0, gain=0.0, load=0.0, noise=0.0, dead=0.0)
COUNTS = torch.arange(8 * 6 * 50, dtype=torch.float32).reshape(8, 6, 50)


def _augmented(how: Augmentation, counts: torch.Tensor = COUNTS) -> torch.Tensor:
    generator = torch.Generator()
    cast("Any", generator).manual_seed(1)
    return augmented(counts, how, generator)[0]


def _only(**chances: float) -> Augmentation:
    return Augmentation(**{"flip": 0.0, "gain": 0.0, "load": 0.0, "noise": 0.0, "dead": 0.0} | chances)  # type: ignore[arg-type]


def test_without_any_chance_nothing_changes() -> None:
    assert torch.equal(_augmented(NOTHING), COUNTS)


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

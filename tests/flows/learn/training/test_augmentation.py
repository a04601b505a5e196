import numpy as np
import torch

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import PAPER_TOUCH, Augmentation
from flows.learn.training.training_loop import Crops, augmented

COUNTS = torch.arange(8 * 6 * 50, dtype=torch.float32).reshape(8, 6, 50)


def _augmented(how: Augmentation, counts: torch.Tensor = COUNTS) -> torch.Tensor:
    return augmented(counts, how, torch.Generator().manual_seed(1))


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
    assert np.abs(np.diff(moved, axis=2)).max() < 0.13 * np.abs(moved).max() * 2  # 2 Hz at 100 Hz, rounded


def test_the_papers_networks_see_each_symmetry_of_the_pad_equally_often_with_noise() -> None:
    cells = 100 * torch.arange(6).expand(4000, 100, 6).float().transpose(1, 2)
    counts = _augmented(PAPER_TOUCH, cells).numpy()
    cell = np.rint(counts / 100)
    assert (cell == cell[:, :, :1]).all()  # a window moves as a whole
    pad = np.array([[5, 4, 3], [0, 1, 2]])  # as it lies
    for symmetry in (pad, pad[:, ::-1], pad[::-1], pad[::-1, ::-1]):
        assert 0.22 < (cell[:, pad.ravel(), 0] == symmetry.ravel()).all(axis=1).mean() < 0.28
    assert 0.49 < (counts - 100 * cell).std() < 0.51  # counts


def _ramp(plan: str) -> LabelledRecording:
    """Return a recording whose counts are the number of the row."""
    counts = np.repeat(np.arange(300, dtype=np.int16)[:, None], 6, axis=1)
    return LabelledRecording(counts, np.zeros(300, np.int8), plan=plan)


def _stretched(plan: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the first rows, rows and counts of 64 crops of a ramp, all stretched by up to 3."""
    crops = Crops([_ramp(plan)], 60, torch.device("cpu"))
    generator = torch.Generator().manual_seed(1)
    first = torch.as_tensor(crops.first)[crops.draw(64, generator)]
    return first, *crops.stretched(first, Augmentation(stretch=1.0, slowest=3.0), generator)


def test_a_slower_hand_passes_fewer_rows_in_the_same_time_and_keeps_its_labels() -> None:
    first, rows, counts = _stretched("wide")
    passed = (counts[:, -1, 0] - first) / 59  # rows per sample
    assert 1 / 3 <= passed.min() < 0.4
    assert 0.9 < passed.max() <= 1
    assert counts.diff(dim=1).std(dim=1).max() < 1e-4
    assert (rows - counts[..., 0]).abs().max() <= 0.5


def test_crops_of_other_plans_are_not_stretched() -> None:
    for plan in ("", "paper", "grasps"):
        first, rows, counts = _stretched(plan)
        assert torch.equal(rows, first[:, None] + torch.arange(60))
        assert torch.equal(counts[..., 0], rows.float())

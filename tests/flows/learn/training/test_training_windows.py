from dataclasses import replace

import numpy as np
import pytest
import torch

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.training_windows import MIRRORED, Windows, mirrored, varied
from operators import InputError
from operators.batch import SLIP, UNKNOWN

CPU = torch.device("cpu")


def _recording(seed: int, samples: int) -> LabelledRecording:
    rng = np.random.default_rng(seed)
    counts = rng.integers(-500, 100, (samples, 6)).astype(np.int16)
    return LabelledRecording(counts, rng.integers(0, 2, samples).astype(np.int8), "plane")


def test_a_window_ends_at_its_label_and_stays_within_its_recording() -> None:
    recordings = [_recording(0, 150), _recording(1, 99), _recording(2, 230)]
    windows = Windows.of(recordings, CPU)
    expected = [
        (recording.counts[end - 99 : end + 1], recording.slip[end])
        for recording in recordings
        for end in recording.evaluated(1)
    ]
    assert len(windows) == 51 + 131
    np.testing.assert_array_equal(windows.take(np.arange(len(windows))), [counts for counts, _ in expected])
    np.testing.assert_array_equal(windows.slip, [slip for _, slip in expected])


def test_samples_without_a_label_are_left_out() -> None:
    recording = _recording(0, 400)
    label = recording.label.copy()
    label[200:300] = UNKNOWN
    windows = Windows.of([replace(recording, label=label)], CPU)
    assert len(windows) == 301 - 100
    assert windows.slip.sum() == (label[99:] == SLIP).sum()


@pytest.mark.parametrize("rarer", [0, 1])
def test_as_many_windows_of_slip_as_of_static_are_drawn_and_anew_each_time(rarer: int) -> None:
    label = np.where(np.arange(400) < 330, 1 - rarer, rarer).astype(np.int8)
    windows, rng = Windows.of([replace(_recording(0, 400), label=label)], CPU), np.random.default_rng(0)
    first, second = windows.balanced(rng), windows.balanced(rng)
    for picked in (first, second):
        assert len(picked) == len(set(picked.tolist())) == 140
        assert windows.slip[picked].sum() == 70
        assert 20 < windows.slip[picked][:70].sum() < 50  # shuffled
    assert set(first.tolist()) != set(second.tolist())


def test_flips_move_each_cell_to_its_mirror_image() -> None:
    cells = torch.arange(6).expand(4, 100, 6).float()
    moved = mirrored(cells, np.arange(4))[:, 0].numpy().astype(int)
    pad = np.array([[5, 4, 3], [0, 1, 2]])  # as it lies
    for motion, expected in zip(moved, (pad[:, ::-1], pad[::-1], pad[::-1, ::-1], pad), strict=True):
        assert np.array_equal(motion[pad], expected)
    assert moved[:2].tolist() == [[2, 1, 0, 5, 4, 3], [5, 4, 3, 2, 1, 0]]
    assert len(MIRRORED) == 4


def test_each_motion_is_made_of_a_quarter_of_the_windows_and_noise_is_added() -> None:
    cells = 100 * torch.arange(6).expand(4000, 100, 6).float()
    rng, generator = np.random.default_rng(0), torch.Generator().manual_seed(0)
    counts = varied(cells, mirror=0.25, noise=0.5, rng=rng, generator=generator).numpy()
    cell = np.rint(counts / 100)
    assert (cell == cell[:, :1]).all()  # a window moves as a whole
    share = [(cell[:, 0] == motion).all(axis=1).mean() for motion in MIRRORED]
    assert sum(share) == pytest.approx(1)
    assert all(0.22 < each < 0.28 for each in share)
    assert (counts - 100 * cell).std() == pytest.approx(0.5, abs=0.01)


def test_the_counts_of_the_recordings_give_mean_and_standard_deviation() -> None:
    recordings = [_recording(0, 150), _recording(1, 230)]
    for recording in recordings:
        recording.counts[:, 3] = 7
    mean, std = Windows.of(recordings, CPU).spread()
    counts = np.concatenate([recording.counts for recording in recordings])
    np.testing.assert_allclose(mean, counts.mean(axis=0))
    np.testing.assert_allclose(np.delete(std, 3), np.delete(counts.std(axis=0), 3))
    assert std[3] == 1  # a cell that never moved divides nothing by 0


@pytest.mark.parametrize("slip", [True, False])
def test_recordings_of_one_class_are_refused(slip: bool) -> None:  # noqa: FBT001
    recording = replace(_recording(0, 400), label=np.full(400, slip, np.int8))
    with pytest.raises(InputError, match="must hold windows of slip and of static"):
        Windows.of([recording], CPU)

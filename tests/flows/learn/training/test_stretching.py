import numpy as np
import pytest
import torch

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.augmentation import stretches
from flows.learn.training.stretching import GAIN, SPREAD, stretched
from flows.learn.training.training_crops import Crops


@pytest.fixture
def ramp() -> LabelledRecording:
    counts = np.arange(100, dtype=np.int16)[:, None] * np.ones(6, np.int16)
    return LabelledRecording(counts, (np.arange(100) >= 50).astype(np.int8), "plane")


def test_a_stretched_recording_is_longer_with_its_labels_in_place(ramp: LabelledRecording) -> None:
    found = stretched(ramp, 2)
    assert len(found) == len(found.counts) == 199
    gain = (GAIN[0] * GAIN[1]) ** 0.5
    np.testing.assert_allclose(found.counts[:, 0], np.arange(199) / 2 * gain, atol=0.51)
    assert abs(int(found.label.argmax()) - 100) <= 1


def test_a_recording_that_is_not_stretched_stays_as_it_is(ramp: LabelledRecording) -> None:
    assert stretched(ramp, 1) is ramp


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

"""What every detector owes, whatever computes its probability."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from operators.detectors import Detector
from operators.detectors.weights import ForOneFingertip
from operators.fingertip import TAKKTILE
from storage import load_detector
from storage.models import shipped_names


@pytest.fixture(params=["psd", *shipped_names()])
def detector(request: pytest.FixtureRequest) -> Detector:
    return load_detector(request.param)


def test_each_window_is_judged_by_itself(detector: Detector) -> None:
    counts = np.random.default_rng(1).integers(-500, 100, (detector.length + 69, 6)).astype(np.int16)
    windows = np.lib.stride_tricks.sliding_window_view(counts, detector.length, axis=0).swapaxes(1, 2)
    one_by_one = [detector.score(windows[i : i + 1]).item() for i in range(len(windows))]
    np.testing.assert_array_equal(detector.score(windows), one_by_one)
    np.testing.assert_array_equal(detector.score(windows[3:37].copy()), one_by_one[3:37])
    again: Detector = pickle.loads(pickle.dumps(detector))  # noqa: S301 our own bytes
    np.testing.assert_array_equal(again.score(windows), one_by_one)


@pytest.mark.parametrize("ratio", [1, 4])
def test_counts_of_a_finer_converter_give_the_same_probability(detector: Detector, ratio: int) -> None:
    counts = np.random.default_rng(1).integers(-500, 100, (3, detector.length, 6)).astype(np.int16)
    assert isinstance(detector, ForOneFingertip)
    finer = detector.for_fingertip(replace(TAKKTILE, range=(ratio * 1023, 0)))
    np.testing.assert_allclose(finer.score(ratio * counts), detector.score(counts), rtol=1e-4, atol=1e-9)
    unknown = detector.for_fingertip(replace(TAKKTILE, range=None))
    np.testing.assert_array_equal(unknown.score(counts), detector.score(counts))


def test_counts_far_from_any_in_training_give_a_probability(detector: Detector) -> None:
    windows = np.full((2, detector.length, 6), 30_000, np.int16)
    windows[1, ::2] = -30_000
    probability = detector.score(windows)
    assert ((probability >= 0) & (probability <= 1)).all()

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.sampling import WARM_UP
from flows.learn.scoring import labels, probabilities, windows
from operators import Score, Zeroed
from operators.batch import Counts, Reals
from operators.detectors import Psd
from operators.score import forward_fill


@dataclass
class Mean:
    """Scores with the mean of its windows, in [0, 1]; a stream of it says 1 wherever its last count is 5."""

    length: int = 20
    name = "mean"

    def score(self, windows: Counts | Reals) -> Reals:
        mean: Reals = windows.mean(axis=(1, 2)) / 1000
        return mean


class Streamed(Mean):
    def stream(self, fingers: int = 1) -> Self:
        assert fingers == 1
        return self

    def push(self, counts: Counts | Reals) -> Reals:
        fives: Reals = (counts[:, :, 5] == 5).astype(np.float64)
        return fives


def recording(
    samples: int, valid: np.ndarray[tuple[int, int], np.dtype[np.bool_]] | None = None
) -> LabelledRecording:
    counts = np.random.default_rng(0).integers(-400, 100, (samples, 6)).astype(np.int16)
    return LabelledRecording(counts, np.zeros(samples, np.int8), valid=valid)


def test_windows_end_with_the_sample_that_is_scored() -> None:
    one = recording(1500)
    found = probabilities(Mean(), one)
    assert np.isnan(found[:WARM_UP]).all()
    expected = [one.counts[end - 19 : end + 1].mean() / 1000 for end in range(WARM_UP, 1500)]
    np.testing.assert_allclose(found[WARM_UP:], expected)


def test_a_streaming_detector_streams() -> None:
    one = recording(300)
    one.counts[150, 5] = 5
    found = probabilities(Streamed(), one)
    assert np.isnan(found[:WARM_UP]).all()
    assert found[150] == 1
    np.testing.assert_array_equal(found[WARM_UP:], one.counts[WARM_UP:, 5] == 5)


def test_a_longer_window_begins_later() -> None:
    found = probabilities(Mean(length=130), recording(140))
    assert np.flatnonzero(np.isfinite(found)).tolist() == list(range(129, 140))


@pytest.mark.parametrize("samples", [0, 1, WARM_UP])
def test_a_recording_that_is_too_short_has_no_score(samples: int) -> None:
    assert np.isnan(probabilities(Mean(), recording(samples))).all()


def test_the_operator_says_the_same() -> None:
    valid = np.random.default_rng(1).random((700, 6)) > 0.4
    one = recording(700, valid)
    scores = Score(Psd()).push(Zeroed(np.arange(700), one.counts, np.zeros((700, 6), np.int16), valid))
    found = probabilities(Psd(), replace(one, counts=forward_fill(one.counts, valid)))
    later = scores.probability[WARM_UP - 24 :]
    assert np.isnan(later).any()
    np.testing.assert_array_equal(found[WARM_UP:], later)


def test_a_window_ends_with_the_sample_that_is_judged() -> None:
    counts = np.arange(150 * 6, dtype=np.int16).reshape(150, 6)
    one = LabelledRecording(counts, np.zeros(150, np.int8))
    assert windows(one, 25, 10)[:, -1, 0].tolist() == counts[99::10, 0].tolist()
    assert windows(one, 100, 10)[0].tolist() == counts[:100].tolist()
    assert len(labels([one, one], 10)) == 2 * len(windows(one, 25, 10))


@pytest.mark.parametrize("samples", [0, 3, WARM_UP])
def test_a_recording_within_the_warm_up_has_no_windows(samples: int) -> None:
    assert windows(recording(samples), 51, 2).shape == (0, 51, 6)


def test_samples_with_an_unknown_label_are_not_fitted_to() -> None:
    counts = np.arange(1800, dtype=np.int16).reshape(300, 6)
    label = np.where(np.arange(300) < 200, -1, 1).astype(np.int8)
    recording = LabelledRecording(counts, label)
    assert labels([recording], 10).tolist() == [True] * 10
    assert windows(recording, 25, 10)[:, -1, 0].tolist() == counts[recording.known(10), 0].tolist()

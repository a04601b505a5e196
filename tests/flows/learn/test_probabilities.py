from dataclasses import replace

import numpy as np
import pytest

from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from operators import Score, Zeroed
from operators.detectors import Detector, Psd
from operators.score import forward_fill
from storage import load_detector


def recording(
    samples: int, valid: np.ndarray[tuple[int, int], np.dtype[np.bool_]] | None = None
) -> LabelledRecording:
    counts = np.random.default_rng(0).integers(-400, 100, (samples, 6)).astype(np.int16)
    return LabelledRecording(counts, np.zeros(samples, np.int8), valid=valid)


@pytest.mark.parametrize("samples", [0, 1, 3, WARM_UP])
def test_a_recording_within_the_warm_up_has_no_score_and_no_windows(samples: int) -> None:
    assert np.isnan(recording(samples).probabilities(Psd())).all()
    assert recording(samples).windows(51, 2).shape == (0, 51, 6)


@pytest.mark.parametrize("detector", [Psd(), Psd(130), load_detector("tcn")], ids=["psd", "longer", "tcn"])
def test_a_probability_is_that_of_a_live_run(detector: Detector) -> None:
    valid = np.random.default_rng(1).random((700, 6)) > 0.4
    one = recording(700, valid)
    scores = Score(detector).push(Zeroed(np.arange(700), one.counts, np.zeros((700, 6), np.int16), valid))
    found = replace(one, counts=forward_fill(one.counts, valid)).probabilities(detector)
    begin = max(WARM_UP, detector.length - 1)
    assert np.isnan(found[:begin]).all()
    later = scores.probability[begin - 700 :]
    assert np.isnan(later).any()
    np.testing.assert_array_equal(found[begin:], later)


def test_a_window_ends_with_the_sample_that_is_judged_after_the_warm_up_if_its_label_is_known() -> None:
    counts = np.arange(1800, dtype=np.int16).reshape(300, 6)
    label = np.where(np.arange(300) < 200, -1, 1).astype(np.int8)
    recording = LabelledRecording(counts, label)
    assert recording.slip[recording.known(10)].tolist() == [True] * 10
    assert recording.windows(25, 10)[:, -1, 0].tolist() == counts[recording.known(10), 0].tolist()
    whole = replace(recording, label=np.ones_like(label))
    assert whole.known(10)[0] == WARM_UP
    assert whole.windows(100, 10)[0].tolist() == counts[WARM_UP - 99 : WARM_UP + 1].tolist()

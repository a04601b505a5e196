"""Fine-tuning on recordings that are hardly longer than a window."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from flows.learn.adaptation.fine_tuning import fine_tune
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training import dense_training
from operators.batch import SLIP
from operators.detectors import Tcn
from operators.errors import InputError, ParameterError

Stroked = Callable[..., LabelledRecording]


def test_short_recordings_are_learned_from_and_judged_as_a_whole(
    learned: Tcn, strokes: Stroked, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = [strokes(seed, seconds=4 + seed % 2) for seed in range(6)]
    seen: list[Sequence[LabelledRecording]] = []
    train = dense_training.train_dense

    def watched(*given: Any) -> object:  # noqa: ANN401 - passed on
        seen.extend(given[:2])
        return train(*given)

    monkeypatch.setattr(dense_training, "train_dense", watched)
    found = fine_tune(learned, short, steps=30)
    fit, judged = ({each.name for each in part} for part in seen)
    assert (len(fit), len(judged)) == (4, 2)
    assert not fit & judged
    assert np.isfinite([found.before, found.after]).all()


def test_the_one_recording_with_slip_is_learned_from(learned: Tcn, strokes: Stroked) -> None:
    short = [strokes(seed, seconds=5) for seed in range(4)]
    for each in short[:3]:
        each.label[:] = 0
    assert (short[3].label == SLIP).any()
    assert not fine_tune(learned, short, steps=3).better  # nothing judges it


def test_recordings_shorter_than_a_window_are_an_error(learned: Tcn, strokes: Stroked) -> None:
    with pytest.raises(InputError, match="is too short to hold out a part: add another recording"):
        fine_tune(learned, [strokes(0, seconds=4)], steps=3)
    shorter = [strokes(seed, seconds=1.8) for seed in range(3)]
    for each in shorter:
        each.label[90:] = SLIP
    with pytest.raises(ParameterError, match="up to 180 samples each, 0 slip and 0 static in those long"):
        fine_tune(learned, shorter, steps=3)

from dataclasses import replace

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import PaperRecipe, Recipe
from operators import Score, Zeroed, ms
from operators.detectors import Tcn
from operators.errors import FingertipError
from operators.fingertip import TAKKTILE, Fingertip, grid
from storage import load_detector
from tests.flows.learn.conftest import shaken
from tests.flows.learn.training.conftest import TrainOn

PAD = Fingertip(grid(16), 1000.0, "kPa", 0.01, (0, 4000))
SMALL = Recipe(filters=4, units=4, steps=6, batch=8, checks=1)


def recordings(fingertip: Fingertip) -> list[LabelledRecording]:
    label = np.repeat(np.arange(30) % 2, 50).astype(np.int8)
    return [
        shaken(seed, label, fingertip.cells, name=split, split=split, fingertip=fingertip)
        for seed, split in enumerate(("train", "train", "validation", "test"))
    ]


def test_a_model_of_16_cells_states_its_fingertip_and_streams_as_it_scores_windows(train_on: TrainOn) -> None:
    detector = load_detector(train_on(recordings(PAD), SMALL).path)
    assert isinstance(detector, Tcn)
    assert (detector.fingertip, detector.cells) == (PAD, 16)
    counts = recordings(PAD)[3].counts
    time = np.arange(len(counts)) * ms
    scores = Score(detector).push(Zeroed(time, counts, 0 * counts, np.ones(counts.shape, np.bool_)))
    windows = np.lib.stride_tricks.sliding_window_view(counts, detector.length, 0).transpose(0, 2, 1)
    assert scores.probability == pytest.approx(detector.score(windows), abs=1e-5)
    with pytest.raises(FingertipError, match=r"model\S* needs 16 cells, .*; the data has 6 cells"):
        recordings(TAKKTILE)[3].probabilities(detector)


def test_recordings_of_different_rates_are_not_trained_on_together(train_on: TrainOn) -> None:
    one, *rest = recordings(TAKKTILE)
    mixed = [one, *(replace(each, fingertip=replace(TAKKTILE, rate=200.0)) for each in rest)]
    with pytest.raises(FingertipError, match=r"data set with train needs 100 Hz; the data has 200 Hz: Res"):
        train_on(mixed, SMALL)


def test_a_network_of_the_paper_is_for_six_cells(train_on: TrainOn) -> None:
    with pytest.raises(FingertipError, match=r"paper_tcn needs 6 cells"):
        train_on(recordings(PAD), PaperRecipe("paper_tcn", 1))

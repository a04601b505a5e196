from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training import trainer
from flows.learn.training.recipe import PaperRecipe, Recipe
from operators import Score, Zeroed, ms
from operators.detectors import Tcn
from operators.errors import FingertipError
from operators.fingertip import TAKKTILE, Fingertip, grid
from storage import load_detector

PAD = Fingertip(grid(16), 1000.0, "kPa", 0.01, (0, 4000))
SMALL = Recipe(filters=4, units=4, steps=6, batch=8, checks=1)


def recordings(fingertip: Fingertip) -> list[LabelledRecording]:
    """Recordings of a fingertip in which slip shakes every cell."""
    found = list[LabelledRecording]()
    for seed, split in enumerate(("train", "train", "validation", "test")):
        rng = np.random.default_rng(seed)
        label = np.repeat(np.arange(30) % 2, 50).astype(np.int8)
        spread = np.where(label == 1, 40.0, 1.0)[:, None]
        counts = rng.normal(0, spread, (1500, fingertip.cells)).round().astype(np.int16)
        found.append(LabelledRecording(counts, label, name=split, split=split, fingertip=fingertip))
    return found


@pytest.fixture
def trained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(trainer, "load", lambda _: recordings(PAD))
    out = tmp_path / "pad.safetensors"
    trainer.train([tmp_path], out, SMALL)
    return out


def test_a_model_of_16_cells_states_its_fingertip_and_streams_as_it_scores_windows(trained: Path) -> None:
    detector = load_detector(trained)
    assert isinstance(detector, Tcn)
    assert (detector.fingertip, detector.cells) == (PAD, 16)
    counts = recordings(PAD)[3].counts
    time = np.arange(len(counts)) * ms
    scores = Score(detector).push(Zeroed(time, counts, 0 * counts, np.ones(counts.shape, np.bool_)))
    windows = np.lib.stride_tricks.sliding_window_view(counts, detector.length, 0).transpose(0, 2, 1)
    assert scores.probability == pytest.approx(detector.score(windows), abs=1e-5)
    with pytest.raises(FingertipError, match=r"pad\S* needs 16 cells, .*; the data has 6 cells"):
        recordings(TAKKTILE)[3].probabilities(detector)


def test_recordings_of_different_rates_are_not_trained_on_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, *rest = recordings(TAKKTILE)
    mixed = [one, *(replace(each, fingertip=replace(TAKKTILE, rate=200.0)) for each in rest)]
    monkeypatch.setattr(trainer, "load", lambda _: mixed)
    with pytest.raises(FingertipError, match=r"data set with train needs 100 Hz; the data has 200 Hz: Res"):
        trainer.train([tmp_path], tmp_path / "model.safetensors", SMALL)


def test_a_network_of_the_paper_is_for_six_cells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trainer, "load", lambda _: recordings(PAD))
    with pytest.raises(FingertipError, match=r"paper_tcn needs 6 cells"):
        trainer.train([tmp_path], tmp_path / "model.safetensors", PaperRecipe("paper_tcn", 1))

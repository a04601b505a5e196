"""Adaptation to real strokes of surfaces, which are not part of the project."""

from pathlib import Path

import polars as pl
import pytest

from flows.learn.adaptation.adapted import adapt
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.trained_model import label_scores
from operators.detectors import Tcn
from storage import load_detector

STROKES = Path(__file__).parents[5] / "shared" / "real" / "strokes"


def read(name: str) -> LabelledRecording:
    frame = pl.read_parquet(STROKES / f"{name}.parquet")
    counts = frame.select([f"b{cell}" for cell in range(6)]).to_numpy().astype("int16")
    return LabelledRecording(counts, frame["label"].to_numpy().astype("int8"), "", name=name)


@pytest.mark.skipif(
    not STROKES.is_dir(), reason=f"no real recordings in {STROKES}: fetch the recipe `strokes`"
)
@pytest.mark.parametrize("surface", ["dvp_flat", "still", "fabric"])
def test_30_s_of_a_surface_improve_the_shipped_network_on_its_other_recordings(surface: str) -> None:
    tcn = load_detector("tcn_wide")
    assert isinstance(tcn, Tcn)
    adapted = adapt(tcn, [read(f"{surface}_vel3").piece(slice(3000))])
    others = [read(f"{surface}_vel{number}") for number in (2, 4, 5)]
    before, after = (label_scores(each, others)["balanced"] for each in (tcn, adapted.tcn))
    assert adapted.better
    assert after > max(before, 85)

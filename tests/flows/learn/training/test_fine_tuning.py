from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training import trainer
from flows.learn.training.dense_training import train_dense
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import label_scores, learned, provenance, write_model
from flows.learn.training.trainer import further
from operators.detectors import Tcn
from operators.detectors.weights import Weights
from operators.errors import InputError
from operators.fingertip import TAKKTILE
from storage import load_detector
from tests.flows.learn.training.conftest import TrainOn

STROKES = Path(__file__).parents[5] / "shared" / "real" / "strokes"
_CELLS = np.array([1.0, 0.6, 0.3, -0.9, -0.5, -0.4])  # response to shear


def stroked(
    seed: int, stroke: float = 0.5, amplitude: float = 120.0, seconds: float = 30.0
) -> LabelledRecording:
    """A finger that rests 1.5 to 3 s between strokes; friction shears the pad while it slides."""
    rng = np.random.default_rng(seed)
    shear, label, sign = list[float](), list[int](), 1.0
    while len(shear) < 100 * seconds:
        rest, slide = round(100 * rng.uniform(1.5, 3)), round(100 * stroke * rng.uniform(0.9, 1.1))
        last = shear[-1] if shear else 0.0
        shear += [last * 0.4 + last * 0.6 * np.exp(-k / 12) for k in range(rest)]
        wave = np.cumsum(rng.normal(0, 0.03, slide))
        shear += [(sign + wave[k]) * (1 - np.exp(-k / 8)) + shear[-1] * np.exp(-k / 8) for k in range(slide)]
        label += [0] * rest + [1] * slide
        sign = -sign
    size = round(100 * seconds)
    counts = amplitude * np.array(shear)[:size, None] * _CELLS + rng.normal(0, 1.5, (size, 6))
    return LabelledRecording(
        np.rint(counts).astype(np.int16), np.array(label[:size], np.int8), name=f"stroked-{seed}"
    )


@pytest.fixture(scope="module")
def arrays() -> Weights:
    """Weights of a small network that learned strokes of 0.5 s and 120 counts."""
    recipe = Recipe(filters=6, units=8, steps=150, batch=8, crop=400, checks=1, rate=1e-2)
    return train_dense([stroked(seed) for seed in range(4)], [stroked(4)], recipe).arrays


@pytest.fixture
def parent(arrays: Weights, tmp_path: Path) -> Path:
    card = {"detector": "tcn", "data": provenance([replace(stroked(0), split="train")])}
    return write_model(tmp_path / "parent.safetensors", arrays, card).path


def test_few_minutes_improve_a_model_on_what_is_held_out_and_its_card_states_the_origin(
    parent: Path, train_on: TrainOn
) -> None:
    given = [stroked(seed, stroke=1.0, amplitude=30.0) for seed in (10, 11)]
    parent_network, done = load_detector(str(parent)), list[int]()
    assert isinstance(parent_network, Tcn)
    model = train_on(given, Recipe(steps=30), start=str(parent), progress=lambda n, *_: done.append(n))
    scores = model.card["scores"]
    assert scores["after"]["balanced"] > scores["before"]["balanced"]
    assert "NOT better" not in model.report()
    assert model.card["parent"]["id"] == "parent"
    assert len(learned(model.card, [stroked(0), *given, stroked(2)])) == 3, "the data of the parent, too"
    assert model.card["recipe"] == asdict(further(parent_network, Recipe(steps=30)))
    assert (len(done), "debounce" in model.card) == (30, True)
    assert isinstance(load_detector(model.path), Tcn)


def test_training_goes_on_from_the_scores_of_the_parent_on_a_converter_of_12_bits(
    parent: Path, train_on: TrainOn, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = (replace(stroked(seed), fingertip=replace(TAKKTILE, range=(4095, 0))) for seed in (10, 11))
    monkeypatch.setattr(trainer, "further", lambda tcn, recipe: replace(further(tcn, recipe), rate=1e-12))
    model = train_on([one, replace(other, split="test")], Recipe(steps=1), start=str(parent))
    assert model.card["scores"]["after"] == model.card["scores"]["before"]


def test_the_test_split_is_held_out_and_a_worse_model_is_called_so(parent: Path, train_on: TrainOn) -> None:
    wrong, truth = stroked(10), stroked(11)
    given = [replace(wrong, label=1 - wrong.label), replace(truth, split="test")]
    model = train_on(given, Recipe(steps=60), start=str(parent))
    assert "NOT better than the model that it was trained from" in model.report()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda one: one.piece(slice(600)), "too short to hold out a part"),
        (lambda one: replace(one, split="test"), "give some to learn from"),
    ],
)
def test_recordings_that_cannot_be_learned_from_are_refused(
    parent: Path, train_on: TrainOn, change: Callable[[LabelledRecording], LabelledRecording], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        train_on([change(stroked(0))], Recipe(steps=3), start=str(parent))


def test_only_a_tcn_is_trained_further(train_on: TrainOn) -> None:
    with pytest.raises(InputError, match="psd: is not a tcn: only a tcn can be trained further"):
        train_on([], Recipe(), start="psd")


def _read(name: str) -> LabelledRecording:
    frame = pl.read_parquet(STROKES / f"{name}.parquet")
    counts = frame.select([f"b{cell}" for cell in range(6)]).to_numpy().astype("int16")
    return LabelledRecording(counts, frame["label"].to_numpy().astype("int8"), name=name)


@pytest.mark.skipif(
    not STROKES.is_dir(), reason=f"no real recordings in {STROKES}: fetch the recipe `strokes`"
)
def test_two_minutes_of_real_strokes_improve_the_shipped_network_on_another_surface() -> None:
    tcn = load_detector("tcn")
    assert isinstance(tcn, Tcn)
    two_minutes = [_read(f"{surface}_vel3").piece(slice(4000)) for surface in ("dvp_flat", "still", "tkan")]
    others = [_read(f"fabric_vel{number}") for number in (2, 4, 5)]
    tuned = Tcn(
        train_dense(two_minutes, others, further(tcn, Recipe(steps=trainer.FURTHER_STEPS)), start=tcn).arrays
    )
    before, after = (label_scores(each, others)["balanced"] or 0.0 for each in (tcn, tuned))
    assert after > max(before, 85)

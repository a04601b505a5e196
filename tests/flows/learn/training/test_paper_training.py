from collections.abc import Callable, Sequence
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.measures import balanced, confusion
from flows.learn.training import training_loop
from flows.learn.training.paper_training import PaperNetwork, Windows, paper_network, train_windowed
from flows.learn.training.recipe import PaperRecipe
from flows.learn.training.trained_model import Arrays
from flows.learn.training.training_loop import Trained
from operators.detectors import Detector, PaperTcn
from operators.detectors.frequency_cnn import FrequencyCnn
from operators.errors import InputError
from tests.flows.learn.conftest import shaken

DETECTORS: dict[str, Callable[[Arrays], Detector]] = {"frequency_cnn": FrequencyCnn, "paper_tcn": PaperTcn}
CPU = torch.device("cpu")
TWICE = PaperRecipe("paper_tcn", batch=64, epochs=2)

both = pytest.mark.parametrize("name", ["frequency_cnn", "paper_tcn"])


def _recording(seed: int, samples: int = 700) -> LabelledRecording:
    """Slip for some seconds, and rest for as long."""
    slip = (2 * np.arange(samples) // samples + seed) % 2
    return shaken(seed, slip.astype(np.int8))


SHORT = [_recording(seed, 300) for seed in range(2)]


def _noise(seed: int, samples: int) -> LabelledRecording:
    rng = np.random.default_rng(seed)
    counts = rng.integers(-500, 100, (samples, 6)).astype(np.int16)
    return LabelledRecording(counts, rng.integers(0, 2, samples).astype(np.int8))


def _balanced(detector: Detector, recordings: Sequence[LabelledRecording]) -> float:
    windows = Windows(recordings, CPU)
    score = detector.score(windows.take(np.arange(len(windows))).numpy().astype(np.int16))
    return float(balanced(confusion(score > 0.5, windows.slip)))


@both
def test_the_loss_falls_and_what_it_learns_holds_on_other_recordings(name: str) -> None:
    train, validation, test = ([_recording(seed) for seed in seeds] for seeds in (range(2), (5,), (7,)))
    trained = train_windowed(train, validation, replace(TWICE, network=name, epochs=4))
    assert len(trained.curve) == 4
    assert trained.curve[-1].loss < 0.8 * trained.curve[0].loss
    detector = DETECTORS[name](trained.arrays)
    assert _balanced(detector, test) > 80
    best = max(epoch.balanced or 0 for epoch in trained.curve)
    assert _balanced(detector, validation) == pytest.approx(best, abs=0.2)


@both
def test_a_seed_gives_the_same_weights_whatever_else_runs_and_another_seed_others(name: str) -> None:
    def weights(seed: int) -> Arrays:
        torch.rand(seed + 3)
        return train_windowed(SHORT, SHORT, replace(TWICE, network=name, seed=seed)).arrays

    first, again, other = weights(0), weights(0), weights(1)
    for array, value in first.items():
        np.testing.assert_array_equal(value, again[array])
        assert value.dtype == np.float32
    assert any(not np.array_equal(value, other[array]) for array, value in first.items())


@pytest.mark.parametrize(
    ("balanced", "best"),
    [
        pytest.param((60.0, 80.0, 80.0, 70.0), 2, id="the first of equals"),
        pytest.param((None,) * 4, 4, id="the last if validation lacks a class"),
    ],
)
def test_the_best_epoch_on_validation_is_kept(
    balanced: tuple[float | None, ...], best: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def trained(each: Sequence[float | None]) -> Trained:
        scores = [(90.0 - epoch, value) for epoch, value in enumerate(each)]
        monkeypatch.setattr(training_loop, "_evaluate", Mock(side_effect=scores))
        result = train_windowed(SHORT, SHORT, PaperRecipe("frequency_cnn", len(scores)))
        assert [(epoch.accuracy, epoch.balanced) for epoch in result.curve] == scores
        return result

    found, rising = trained(balanced), trained([60.0, 70.0, 80.0, 90.0][:best])
    for array, value in found.arrays.items():
        np.testing.assert_array_equal(value, rising.arrays[array])


def test_the_longest_gradient_of_an_array_bounds_its_step() -> None:
    def kernel(clip: float) -> NDArray[np.float32]:
        recipe = replace(TWICE, epochs=1, clip=clip)
        return train_windowed(SHORT, SHORT, recipe).arrays["out/kernel"]

    at_rest = paper_network(np.zeros(6), np.ones(6), TWICE).arrays()["out/kernel"]
    free, bound = kernel(1.0), kernel(1e-12)  # so short that Adam's epsilon outweighs it
    assert np.abs(bound - at_rest).max() < 1e-6 < np.abs(free - at_rest).max()


def test_a_window_ends_at_its_label_and_stays_within_its_noise() -> None:
    recordings = [_noise(0, 150), _noise(1, 99), _noise(2, 230)]
    windows = Windows(recordings, CPU)
    expected = [
        (recording.counts[end - 99 : end + 1], recording.slip[end])
        for recording in recordings
        for end in range(99, len(recording))
    ]
    assert len(windows) == 51 + 131
    np.testing.assert_array_equal(windows.take(np.arange(len(windows))), [counts for counts, _ in expected])
    np.testing.assert_array_equal(windows.slip, [slip for _, slip in expected])


@pytest.mark.parametrize("rarer", [0, 1])
def test_as_many_windows_of_slip_as_of_static_are_drawn_and_anew_each_time(rarer: int) -> None:
    label = np.where(np.arange(400) < 330, 1 - rarer, rarer).astype(np.int8)
    windows, rng = Windows([replace(_noise(0, 400), label=label)], CPU), np.random.default_rng(0)
    first, second = windows.balanced(rng), windows.balanced(rng)
    for picked in (first, second):
        assert len(picked) == len(set(picked.tolist())) == 140
        assert windows.slip[picked].sum() == 70
        assert 20 < windows.slip[picked][:70].sum() < 50  # shuffled
    assert set(first.tolist()) != set(second.tolist())


@pytest.mark.parametrize("slip", [True, False])
def test_recordings_of_one_class_are_refused(slip: bool) -> None:
    recording = replace(_noise(0, 400), label=np.full(400, slip, np.int8))
    with pytest.raises(InputError, match="must have windows of slip and of static"):
        Windows([recording], CPU)


def _network(name: str, generator: torch.Generator) -> PaperNetwork:
    """Return a network with weights and running statistics that are nowhere 0 or 1."""
    network = paper_network(np.linspace(-200, 0, 6), np.linspace(180, 60, 6), PaperRecipe(name, 1))
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(torch.randn(parameter.shape, generator=generator), alpha=0.1)
        for _ in range(20):
            network(_counts(64, generator))
    return network.eval()


def _counts(windows: int, generator: torch.Generator) -> Tensor:
    levels = -300 * torch.rand(windows, 1, 6, generator=generator)
    return (levels + 40 * torch.randn(windows, 100, 6, generator=generator)).round()


@both
def test_the_detector_of_the_exported_arrays_gives_the_networks_probabilities(name: str) -> None:
    generator = torch.Generator().manual_seed(0)
    network, counts = _network(name, generator), _counts(200, generator)
    detector: Detector = DETECTORS[name](network.arrays())
    with torch.no_grad():
        expected = network(counts).softmax(1)[:, 1].numpy()
    assert np.ptp(expected) > 0.2
    assert detector.name == name
    np.testing.assert_allclose(detector.score(counts.numpy().astype(np.int16)), expected, atol=1e-5)

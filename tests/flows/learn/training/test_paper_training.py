from collections.abc import Callable, Sequence
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training import paper_training as paper
from flows.learn.training.learning_curve import Check
from flows.learn.training.paper_networks import PaperTcnNetwork
from flows.learn.training.paper_training import (
    WINDOWED,
    Arrays,
    PaperRecipe,
    train_windowed,
)
from flows.learn.training.training_windows import Windows
from operators import ParameterError
from operators.batch import Flags
from operators.detectors import Detector, PaperTcn
from operators.detectors.frequency_cnn import FrequencyCnn, InterleavedFrequencyCnn

DETECTORS: dict[str, Callable[[Arrays], Detector]] = {
    "frequency_cnn": FrequencyCnn,
    "frequency_cnn_interleaved": InterleavedFrequencyCnn,
    "paper_tcn": PaperTcn,
}
CPU = torch.device("cpu")
SMALL = PaperRecipe(batch=64)

every = pytest.mark.parametrize("name", WINDOWED)


def _recording(seed: int, samples: int = 700) -> LabelledRecording:
    """Stick-slip at 15 Hz for some seconds, and rest for as long."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples)
    slip = (2 * time // samples + seed) % 2 == 1
    wave = np.sin(2 * np.pi * 15 * time / 100 + rng.uniform(0, 6))
    counts = -150 + 3 * rng.normal(size=(samples, 6)) + 60 * np.outer(slip * wave, rng.uniform(0.5, 1, 6))
    return LabelledRecording(counts.round().astype(np.int16), slip.astype(np.int8), "plane")


def _accuracy(detector: Detector, recordings: Sequence[LabelledRecording]) -> float:
    """Balanced."""
    windows = Windows.of(recordings, CPU)
    called: Flags = detector.score(windows.take(np.arange(len(windows))).numpy().astype(np.int16)) > 0.5
    right = called == windows.slip
    return float(right[windows.slip].mean() + right[~windows.slip].mean()) / 2


@every
def test_the_loss_falls_and_what_it_learns_holds_on_other_recordings(name: str) -> None:
    train, validation, test = ([_recording(seed) for seed in seeds] for seeds in (range(4), (5, 6), (7, 8)))
    seen: list[Check] = []
    weights, history = train_windowed(
        name, train, validation, seed=0, epochs=5, recipe=SMALL, progress=seen.append
    )
    assert seen == history
    assert [epoch.done for epoch in history] == [1, 2, 3, 4, 5]
    assert history[-1].loss < 0.8 * history[0].loss
    assert _accuracy(DETECTORS[name](weights), test) > 0.8
    best = max(epoch.balanced for epoch in history)
    assert 100 * _accuracy(DETECTORS[name](weights), validation) == pytest.approx(best, abs=0.2)


@every
def test_a_seed_gives_the_same_weights_whatever_else_runs_and_another_seed_others(name: str) -> None:
    recordings = [_recording(seed, 300) for seed in range(2)]

    def weights(seed: int) -> Arrays:
        torch.rand(seed + 3)
        return train_windowed(name, recordings, recordings, seed=seed, epochs=2, recipe=SMALL)[0]

    first, again, other = weights(0), weights(0), weights(1)
    for array, value in first.items():
        np.testing.assert_array_equal(value, again[array])
        assert value.dtype == np.float32
    assert any(not np.array_equal(value, other[array]) for array, value in first.items())


def test_the_best_epoch_on_validation_is_kept_the_first_of_equals(monkeypatch: pytest.MonkeyPatch) -> None:
    recordings = [_recording(seed, 300) for seed in range(2)]
    scores = [(50.0, 60.0), (70.0, 80.0), (90.0, 80.0), (60.0, 70.0)]
    monkeypatch.setattr(paper, "_evaluate", Mock(side_effect=[*scores[:2], *scores]))
    two, _ = train_windowed("frequency_cnn", recordings, recordings, seed=0, epochs=2)
    weights, history = train_windowed("frequency_cnn", recordings, recordings, seed=0, epochs=4)
    assert [(epoch.accuracy, epoch.balanced) for epoch in history] == scores
    for array, value in weights.items():
        np.testing.assert_array_equal(value, two[array])


def test_dropout_is_on_in_steps_and_off_on_validation(monkeypatch: pytest.MonkeyPatch) -> None:
    recordings, seen = [_recording(seed, 300) for seed in range(2)], list[tuple[bool, bool]]()
    logits = PaperTcnNetwork.logits

    def watched(network: PaperTcnNetwork, inputs: Tensor) -> Tensor:
        seen.append((network.training, torch.is_grad_enabled()))
        return logits(network, inputs)

    monkeypatch.setattr(PaperTcnNetwork, "logits", watched)
    train_windowed("paper_tcn", recordings, recordings, seed=0, epochs=2)
    assert seen == [(True, True), (False, False)] * 2  # a step and a block each


def test_each_step_is_reported() -> None:
    recordings, seen = [_recording(seed, 300) for seed in range(2)], list[tuple[int, int]]()
    windows = Windows.of(recordings, CPU)
    steps = len(windows.balanced(np.random.default_rng(0))) // SMALL.batch
    train_windowed(
        "frequency_cnn",
        recordings,
        recordings,
        seed=0,
        epochs=2,
        recipe=SMALL,
        step=lambda done, of: seen.append((done, of)),
    )
    assert steps > 1
    assert seen == 2 * [(done, steps) for done in range(1, steps + 1)]


def test_fewer_windows_than_a_batch_make_one_step() -> None:
    recordings = [_recording(0, 230)]
    seen: list[tuple[int, int]] = []
    train_windowed(
        "paper_tcn", recordings, recordings, seed=0, epochs=1, step=lambda done, of: seen.append((done, of))
    )
    assert seen == [(1, 1)]


def test_the_longest_gradient_of_an_array_bounds_its_step() -> None:
    recordings = [_recording(seed, 300) for seed in range(2)]
    free, bound = (
        train_windowed(
            "paper_tcn", recordings, recordings, seed=0, epochs=1, recipe=replace(SMALL, clip=clip)
        )[0]
        for clip in (1.0, 1e-12)  # so short that Adam's epsilon outweighs it
    )
    at_rest = _rest("out/kernel")
    assert np.abs(bound["out/kernel"] - at_rest).max() < 1e-6 < np.abs(free["out/kernel"] - at_rest).max()


def _rest(name: str) -> NDArray[np.float32]:
    """An array before any step; mean and standard deviation do not enter the first weights."""
    generator = torch.Generator().manual_seed(0)
    return PaperTcnNetwork(np.zeros(6), np.ones(6), dropout=0.2, generator=generator).arrays()[name]


def test_an_unknown_network_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"name is 'lstm', must be one of frequency_cnn, "):
        train_windowed("lstm", [_recording(0)], [_recording(1)], seed=0, epochs=1)


def test_zero_epochs_are_refused() -> None:
    with pytest.raises(ParameterError, match="epochs is 0, must be at least 1"):
        train_windowed("paper_tcn", [_recording(0)], [_recording(1)], seed=0, epochs=0)

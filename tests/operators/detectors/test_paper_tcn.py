from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.batch import Counts, Reals
from operators.detectors import PaperTcn
from operators.detectors.paper_tcn import shapes

REAL = Path(__file__).parents[3].parent / "shared" / "real"
Arrays = dict[str, NDArray[Any]]


def _random() -> Arrays:
    rng = np.random.default_rng(0)
    weights = {name: rng.normal(size=shape) / 2 for name, shape in shapes().items()}
    return weights | {"mean": np.full(6, -200.0), "std": np.full(6, 150.0)}


def _real(name: str) -> Arrays:
    if not (REAL / name).exists():
        pytest.skip(f"no real weights at {REAL / name}")
    with np.load(REAL / name) as arrays:
        return dict(arrays)


def _windows(rows: int) -> Counts:
    counts = np.random.default_rng(1).integers(-500, 100, (rows + 99, 6)).astype(np.int16)
    return np.lib.stride_tricks.sliding_window_view(counts, 100, axis=0).swapaxes(1, 2)


def _plain(weights: Arrays, inputs: Reals) -> Reals:
    """The network as the paper states it: every step of every layer, in double precision."""

    def dense(values: Reals, name: str) -> Reals:
        return values @ weights[f"{name}/kernel"] + weights[f"{name}/bias"]

    def conv(values: Reals, name: str, dilation: int) -> Reals:
        kernel, steps = weights[f"{name}/kernel"], values.shape[1]
        padded = np.pad(values, ((0, 0), ((len(kernel) - 1) * dilation, 0), (0, 0)))
        taps = [padded[:, i * dilation :][:, :steps] @ kernel[i] for i in range(len(kernel))]
        return sum(taps, weights[f"{name}/bias"])

    def norm(values: Reals, name: str) -> Reals:
        centred = values - values.mean(axis=-1, keepdims=True)
        spread = np.sqrt((centred**2).mean(axis=-1, keepdims=True) + 1e-3)
        return selu(centred / spread * weights[f"{name}/gamma"] + weights[f"{name}/beta"])

    def selu(values: Reals) -> Reals:
        return 1.0507009873554805 * np.where(
            values > 0, values, 1.6732632423543772 * np.expm1(np.minimum(values, 0))
        )

    values = inputs
    for block in range(4):
        residual = conv(values, "block0/match", 1) if block == 0 else values
        for layer in range(2):
            values = norm(conv(values, f"block{block}/conv{layer}", 2**block), f"block{block}/ln{layer}")
        values = selu(residual + values)
    values = values[:, -1]
    for layer in range(2):
        values = norm(dense(values, f"dense{layer}"), f"dense{layer}_ln")
    odds = np.exp(dense(values, "out"))
    probability: Reals = odds[:, 1] / odds.sum(axis=1)
    return probability


def test_it_is_the_network_that_the_paper_states() -> None:
    weights, windows = _random(), _windows(40)
    expected = _plain(weights, (windows - weights["mean"]) / weights["std"])
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(PaperTcn(weights).score(windows), expected, atol=1e-5)


def test_the_probabilities_equal_those_of_the_original_network() -> None:
    vectors = _real("paper_tcn_vectors.npz")
    probability = PaperTcn(_real("paper_tcn.npz")).probability(vectors["inputs"])
    np.testing.assert_allclose(probability, vectors["slip_probability"], atol=1e-5)


def test_it_has_the_originals_accuracy_on_the_real_trace() -> None:
    detector = PaperTcn(_real("paper_tcn.npz"))
    table = np.genfromtxt(REAL / "mat_trace.csv", delimiter=",", names=True)
    counts = np.stack([table[f"s{cell}"] for cell in range(1, 7)], axis=1).astype(np.int16)
    windows = np.lib.stride_tricks.sliding_window_view(counts, 100, axis=0).swapaxes(1, 2)
    right = (detector.score(windows) >= 0.5) == (table["label"][99:] == 1)
    assert len(right) == 278
    assert right.mean() == pytest.approx(0.687, abs=5e-4)

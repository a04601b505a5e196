from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.batch import Counts, Reals
from operators.detectors.frequency_cnn import FrequencyCnn, shapes

Arrays = dict[str, NDArray[Any]]


def _random() -> Arrays:
    rng = np.random.default_rng(0)
    weights = {name: rng.normal(size=shape) / prod(shape[:-1]) ** 0.5 for name, shape in shapes().items()}
    return weights | {
        "out/bias": np.array([0, 4.4]),
        "mean": np.linspace(-250, -100, 6),
        "std": np.linspace(300, 150, 6),
    }


def _windows(rows: int) -> Counts:
    rng = np.random.default_rng(1)
    swell = np.linspace(0, 1, rows + 99)[:, None] * rng.permutation(6)
    counts = (-150 + 60 * swell * rng.normal(size=(rows + 99, 6))).clip(-500, 200).astype(np.int16)
    return np.lib.stride_tricks.sliding_window_view(counts, 100, axis=0).swapaxes(1, 2)


def _interleaved(inputs: Reals) -> Reals:
    """Return the spectra of standardised counts (100, 6) as an image (2, 3, 51), as the authors made it."""
    image = np.abs(np.fft.fft(inputs.reshape(2, 3, 100)))[:, :, :51]
    image = np.flip(image, 0).copy()
    image[0] = np.flip(image[0], 0).copy()
    return image


def _plain(weights: Arrays, image: Reals) -> float:
    """The network on an image, pixel by pixel, in double precision."""

    def conv(image: Reals, name: str) -> Reals:
        kernel = weights[f"{name}/kernel"]
        rows, columns = (image.shape[axis] - kernel.shape[axis] + 1 for axis in (0, 1))
        pixels = [
            [
                np.tensordot(image[row : row + len(kernel), column : column + len(kernel)], kernel, 3)
                for column in range(columns)
            ]
            for row in range(rows)
        ]
        result: Reals = np.maximum(np.array(pixels) + weights[f"{name}/bias"], 0)
        return result

    def dense(values: Reals, name: str) -> Reals:
        result: Reals = values @ weights[f"{name}/kernel"] + weights[f"{name}/bias"]
        return result

    image = conv(conv(np.pad(image, ((1, 1), (1, 1), (0, 0))), "conv0"), "conv1")
    assert image.shape == (1, 2, 20)
    values = image.reshape(-1)
    for layer in ("dense0", "dense1"):
        values = np.maximum(dense(values, layer), 0)
    odds = np.exp(dense(values, "out"))
    return float(odds[1] / odds.sum())


def test_it_is_the_network_that_the_paper_states() -> None:
    weights, windows = _random(), _windows(40)
    inputs = (windows - weights["mean"]) / weights["std"]
    expected = [_plain(weights, _interleaved(each)) for each in inputs]
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(FrequencyCnn(weights).score(windows), expected, atol=1e-5)

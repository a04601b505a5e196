"""Frequency CNN of the paper, as its authors ran it; numpy inference."""

from typing import Final

import numpy as np

from operators.batch import BAROMETERS, Counts, Reals
from operators.detectors.weights import Floats, ForOneFingertip, Weights, check_weights

BINS: Final = 51  # bins of a spectrum, 0 to 50 Hz
PIXELS: Final = (5, 4, 3, 0, 1, 2)  # spectrum of each pixel, row by row of the image

_LENGTH: Final = 100  # samples
_LARGEST: Final = 700.0  # exp overflows slightly above it
_PADDED: Final = np.pad(np.arange(6).reshape(2, 3), 1, constant_values=6)  # (4, 5) pixels, surrounded by 6
_SAME: Final = np.lib.stride_tricks.sliding_window_view(_PADDED, (3, 3)).reshape(6, 9)
_VALID: Final = np.lib.stride_tricks.sliding_window_view(_PADDED[1:3, 1:4], (2, 2)).reshape(2, 4)
_SPECTRUM: Final = np.fft.rfft(np.eye(_LENGTH))  # (100, 51)
PARTS: Final = np.concatenate((_SPECTRUM.real, _SPECTRUM.imag), axis=1)  # (100, 102) parts of the DFT


class FrequencyCnn(ForOneFingertip):
    """Detect slip in the spectra of 1 s, arranged as an image of the fingertip.

    The pixels of the (2, 3) image are the rows 5 4 3 above 0 1 2 of the counts in the shape (6, 100). The
    51 channels are |DFT| of a standardised row, without window function. A 3x3 convolution to 50 channels
    with zero padding and a 2x2 convolution to 20 channels without padding leave (1, 2) pixels; dense layers
    of 40, 20 and 2 units follow.

    The authors' code reshapes a window (100, 6) to (6, 100) instead of transposing it. So a row is not the
    signal of one barometer: its 100 values are 16 or 17 successive samples of all six barometers,
    interleaved. The rows follow each other in time; row 5 is the newest.

    All layers but the last have batch norm and ReLU; the convolutions apply ReLU first. Batch norm after
    ReLU is folded into the next layer, batch norm before ReLU into its own. Before folding, the network has
    the paper's 29,782 parameters: 23,000 + 4,020 in the convolutions, 1,640 + 820 + 42 in the dense layers
    and 260 in batch norm. No other padding gives that number.

    Args:
        weights: ``conv0/kernel`` (rows, columns, in, out), ``conv0/bias``, ``conv1/...``; ``dense0/kernel``
            (in, out), ``.../bias``, ``dense1/...``, ``out/...``; ``mean`` and ``std`` of the counts in
            training. `shapes` lists them.

    Raises:
        InputError: if an array is missing, has a wrong shape or is not finite, or a ``std`` is not above 0.

    References:
        "Under Pressure" (2021), frequency CNN.
    """

    name = "frequency_cnn"
    length = _LENGTH

    def __init__(self, weights: Weights) -> None:
        check_weights(type(self).__name__, weights, shapes())
        self._mean, self._std = weights["mean"], weights["std"]
        conv0, conv1, *self._dense = (
            (_flat(weights[f"{layer}/kernel"]), weights[f"{layer}/bias"].astype(np.float32))
            for layer in ("conv0", "conv1", "dense0", "dense1")
        )
        self._convolutions = (_SAME, *conv0), (_VALID, *conv1)
        self._out = np.diff(weights["out/kernel"], axis=1).astype(np.float32)  # (20, 1) slip against static
        self._out_bias = float(np.diff(weights["out/bias"])[0])

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, 100, 6) of zeroed counts; (n,)."""
        count = len(windows)
        values = np.zeros((count, BAROMETERS + 1, BINS), np.float32)  # the last pixel is the padding
        rows = ((windows - self._mean) / self._std).reshape(-1, BAROMETERS, _LENGTH)
        values[:, :BAROMETERS] = _magnitude(rows)[:, PIXELS]
        # one matrix product per window: the rounding of a joint one depends on the number of windows
        for taps, kernel, bias in self._convolutions:
            seen = values[:, taps].reshape(count, len(taps), len(kernel))
            values = np.maximum(seen @ kernel + bias, 0)  # (n, 6, 50), (n, 2, 20)
        values = values.reshape(count, 1, 40)
        for kernel, bias in self._dense:
            values = np.maximum(values @ kernel + bias, 0)  # (n, 1, 40), (n, 1, 20)
        logit = (values @ self._out)[:, 0, 0].astype(np.float64) + self._out_bias  # (n,)
        return 1 / (1 + np.exp(np.minimum(-logit, _LARGEST)))


def shapes() -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of weights."""
    kernels = {
        "conv0": (3, 3, BINS, 50),
        "conv1": (2, 2, 50, 20),
        "dense0": (40, 40),
        "dense1": (40, 20),
        "out": (20, 2),
    }
    result: dict[str, tuple[int, ...]] = {"mean": (BAROMETERS,), "std": (BAROMETERS,)}
    for layer, kernel in kernels.items():
        result[f"{layer}/kernel"], result[f"{layer}/bias"] = kernel, kernel[-1:]
    return result


def _flat(kernel: Floats) -> Floats:
    return kernel.reshape(-1, kernel.shape[-1]).astype(np.float32)


def _magnitude(rows: Reals) -> Reals:
    """Return |DFT| of rows (n, 6, 100); (n, 6, 51).

    With a matrix product, the rounding of a window does not depend on other windows.
    """
    parts = rows.astype(np.float64, order="C") @ PARTS
    magnitude: Reals = np.sqrt(np.square(parts[..., :BINS]) + np.square(parts[..., BINS:]))
    return magnitude

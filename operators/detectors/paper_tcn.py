"""Temporal convolutional network of the paper; numpy inference."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from operators.batch import BAROMETERS, Counts, Reals
from operators.detectors.weights import Floats, ForOneFingertip, Weights, check_weights

_LENGTH: Final = 100  # samples
_BLOCKS: Final = 4
_TAPS: Final = 8
_FILTERS: Final = 12
_UNITS: Final = 24
_EPSILON: Final = np.float32(1e-3)  # of the layer norm
_SCALE: Final = np.float32(1.0507009873554805)  # of SELU
_ALPHA: Final = np.float32(1.0507009873554805 * 1.6732632423543772)  # of SELU, scaled


class PaperTcn(ForOneFingertip):
    """Detect slip with the temporal convolutional network of the paper.

    Four residual blocks of two causal convolutions, dilated 1, 2, 4 and 8, and two dense layers, each
    followed by layer norm and SELU. The receptive field of 211 samples is longer than the window, so the
    zero padding affects the result. Only the steps that the last step depends on are computed: after a
    block with dilation d, every 2d-th step. So each block halves the number of steps and needs no dilation.

    Args:
        weights: Arrays in the shapes of Keras: ``block0/conv0/kernel`` (taps, in, out), ``.../bias``,
            ``block0/ln0/gamma``, ``.../beta``, up to ``out/bias``; ``mean`` and ``std`` of the counts in
            training. `shapes` lists them.

    Raises:
        InputError: if an array is missing, has a wrong shape or is not finite, or a ``std`` is not above 0.

    References:
        "Under Pressure" (2021), Table I.
    """

    name = "paper_tcn"
    length = _LENGTH

    def __init__(self, weights: Weights) -> None:
        check_weights("PaperTcn", weights, shapes())
        steps = [_LENGTH]
        while len(steps) < _BLOCKS:
            steps.append(_halved(steps[-1]))  # into each block: 100, 50, 25, 13
        self._mean, self._std = weights["mean"], weights["std"]
        self._blocks = [
            (
                _Layer.of(weights, f"block{block}/conv0", f"block{block}/ln0", size),
                _Layer.of(weights, f"block{block}/conv1", f"block{block}/ln1", _halved(size)),
            )
            for block, size in enumerate(steps)
        ]
        self._match = weights["block0/match/kernel"][0].astype(np.float32)  # (6, 12)
        self._match_bias = weights["block0/match/bias"].astype(np.float32)
        self._dense = [_Layer.of(weights, f"dense{i}", f"dense{i}_ln", 1) for i in range(2)]
        self._out = np.diff(weights["out/kernel"], axis=1).astype(np.float32)  # (24, 1) slip against static
        self._out_bias = float(np.diff(weights["out/bias"])[0])

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, 100, 6) of zeroed counts; (n,)."""
        return self.probability(((windows - self._mean) / self._std).astype(np.float32, order="C"))

    def probability(self, inputs: Floats) -> Reals:
        """Return the probability of slip of standardised counts (n, 100, 6); (n,)."""
        values = inputs
        for number, (first, second) in enumerate(self._blocks):
            residual = values[:, 1 - values.shape[1] % 2 :: 2]  # every second step, counted from the last
            if number == 0:
                residual = residual @ self._match + self._match_bias
            values = _selu(second(_taps(first(_taps(values, 1)), 2)) + residual)
        values = values[:, -1:]  # (n, 1, 12)
        for layer in self._dense:
            values = layer(values)
        logit = (values @ self._out)[:, 0, 0].astype(np.float64) + self._out_bias  # (n,)
        return 1 / (1 + np.exp(-logit))


@dataclass(frozen=True)
class _Layer:
    """Linear layer, layer norm over its outputs, SELU.

    The mean that the norm subtracts is removed from the weights in advance.
    """

    kernel: Floats  # (inputs, outputs)
    bias: Floats  # (steps, outputs), like gamma and beta: repeated for speed
    gamma: Floats
    beta: Floats

    @classmethod
    def of(cls, weights: Weights, linear: str, norm: str, steps: int) -> Self:
        kernel, bias = weights[f"{linear}/kernel"], weights[f"{linear}/bias"]
        kernel = kernel.reshape(-1, kernel.shape[-1])
        rows = (bias - bias.mean(), weights[f"{norm}/gamma"], weights[f"{norm}/beta"])
        repeated = [np.tile(row, (steps, 1)).astype(np.float32) for row in rows]
        return cls((kernel - kernel.mean(axis=1, keepdims=True)).astype(np.float32), *repeated)

    def __call__(self, values: Floats) -> Floats:
        """Map (n, steps, inputs) to (n, steps, outputs)."""
        outputs = values @ self.kernel + self.bias
        mean = np.full((outputs.shape[2],) * 2, 1 / outputs.shape[2], np.float32)  # as a matrix: faster
        outputs /= np.sqrt(np.square(outputs) @ mean + _EPSILON)
        return _selu(outputs * self.gamma + self.beta)


def _selu(values: Floats) -> Floats:
    above: Floats = np.maximum(values, 0)
    below: Floats = np.exp(np.minimum(values, 0))
    above *= _SCALE
    below *= _ALPHA
    below -= _ALPHA
    above += below
    return above


def _halved(steps: int) -> int:
    return (steps + 1) // 2


def _taps(values: Floats, stride: int) -> Floats:
    """Return the zero-padded inputs of a causal convolution at every `stride`-th step from the last.

    Args:
        values: (n, steps, channels)
        stride: 1 or 2

    Returns:
        (n, steps / stride, taps * channels)
    """
    count, steps, channels = values.shape
    padded = np.zeros((count, steps + _TAPS - 1, channels), np.float32)
    padded[:, _TAPS - 1 :] = values
    window, step, item = padded.strides
    first = (steps - 1) % stride
    seen = (count, (steps - 1) // stride + 1, _TAPS * channels)
    return np.ndarray(seen, np.float32, padded, first * step, (window, stride * step, item)).copy()


def shapes() -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of weights."""
    result: dict[str, tuple[int, ...]] = {"mean": (BAROMETERS,), "std": (BAROMETERS,)}

    def linear(name: str, *kernel: int) -> None:
        result[f"{name}/kernel"], result[f"{name}/bias"] = kernel, kernel[-1:]

    def norm(name: str, size: int) -> None:
        result[f"{name}/gamma"] = result[f"{name}/beta"] = (size,)

    for block in range(_BLOCKS):
        for conv in range(2):
            linear(f"block{block}/conv{conv}", _TAPS, _FILTERS if block or conv else BAROMETERS, _FILTERS)
            norm(f"block{block}/ln{conv}", _FILTERS)
    linear("block0/match", 1, BAROMETERS, _FILTERS)
    for dense, inputs in enumerate((_FILTERS, _UNITS)):
        linear(f"dense{dense}", inputs, _UNITS)
        norm(f"dense{dense}_ln", _UNITS)
    linear("out", _UNITS, 2)
    return result

"""Streaming inference of the TCN: cached causal convolutions, compiled with numba.

A layer with dilation d reads every d-th of its inputs. They are stored in d interleaved rings, each value
twice, `taps` slots apart. So the inputs of the taps are always contiguous, oldest first, and a layer is one
product of a matrix and a vector, computed four outputs at a time: each input is loaded once for the four.
Layers are padded with zeros to a multiple of four outputs. A ring of 4 taps after the inputs 0 to 5::

    4 5 2 3 4 5 2 3       the newest, 5, is in slots 1 and 5; the inputs 2 3 4 5 start after the first

The result of a sample depends neither on the number of samples nor on the number of fingertips per call.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Final

import numpy as np
from numba import from_dtype, types

from operators.batch import Counts, Reals, Times
from operators.checks import check_at_least
from operators.compilation import compile_function
from operators.detectors.weights import CausalLayer, Floats
from operators.errors import ParameterError

_TAPS, _CHANNELS, _DILATION, _RINGS, _KERNEL, _SKIP = range(6)  # columns of the table of layers
_VECTORIZED: Final = {"reassoc", "contract", "nsz"}  # sums in any order
_TOGETHER: Final = 4  # outputs that are computed together
_TABLE: Final = 2046  # largest step of a 10-bit count; asinh of whole numbers up to it is tabulated
_ENTRIES: Final = 2 * _TABLE + 1


@compile_function(fastmath=_VECTORIZED)
def _slot(layers: Times, layer: int, time: int) -> int:
    """Return the memory slot of a layer's input at a time; its copy is taps * channels later."""
    taps, dilation = layers[layer, _TAPS], layers[layer, _DILATION]
    slot = time % dilation * 2 * taps + time // dilation % taps
    index: int = layers[layer, _RINGS] + slot * layers[layer, _CHANNELS]
    return index


@compile_function(fastmath=_VECTORIZED)
def _products(a: Floats, b: Floats, c: Floats, d: Floats, run: Floats) -> tuple[np.float32, ...]:
    """Return the dot products of four rows of a kernel with the inputs."""
    w = x = y = z = np.float32(0)
    for i in range(len(run)):
        value = run[i]
        w += a[i] * value
        x += b[i] * value
        y += c[i] * value
        z += d[i] * value
    return w, x, y, z


@compile_function(fastmath=_VECTORIZED)
def _asinh(count: np.float32, weights: Floats, scale: int) -> float:
    """Return asinh(count / scale), which takes ten times as long if it is not in the table."""
    if abs(count) <= _TABLE and count == int(count):  # in this order: int of NaN or infinity is undefined
        return float(weights[2 + scale * _ENTRIES + _TABLE + int(count)])
    return math.asinh(count / weights[scale])


@compile_function(fastmath=_VECTORIZED)
def _enter(counts: Counts | Reals, time: int, memory: Floats, new: int, again: int, weights: Floats) -> None:
    """Store a fingertip's counts (cells,), and position and step of each in both slots."""
    cells = len(counts)
    for cell in range(cells):
        count = np.float32(counts[cell])
        step = count - memory[cell] if time > 0 else np.float32(0)
        memory[cell] = count
        memory[new + cell] = memory[again + cell] = _asinh(count, weights, 0)
        memory[new + cells + cell] = memory[again + cells + cell] = _asinh(step, weights, 1)


def advance(
    counts: Counts | Reals, results: Reals, memory: Floats, seen: int, weights: Floats, layers: Times
) -> None:
    """Process the next samples.

    Args:
        counts: (n, fingers, cells)
        results: (n, fingers) probability, output
        memory: (fingers, size) previous counts, then the rings of each layer; changed in place
        seen: Number of samples before.
        weights: (m,) scales of counts and of steps; a table of asinh for each; kernel (outputs, taps,
            inputs) and bias of each layer
        layers: (layers + 1, 6) taps, input channels, dilation, offset of the rings in `memory`, offset of the
            kernel in `weights`, and whether the input of the previous layer is added; the last row is the
            logit
    """
    size, fingers, _ = counts.shape
    last = len(layers) - 1
    for time in range(seen, seen + size):
        old = new = _slot(layers, 0, time)
        again = new + layers[0, _TAPS] * layers[0, _CHANNELS]
        for finger in range(fingers):
            _enter(counts[time - seen, finger], time, memory[finger], new, again, weights)
        for layer in range(last):
            older, old, new = old, new, _slot(layers, layer + 1, time)
            channels, outputs = layers[layer, _CHANNELS], layers[layer + 1, _CHANNELS]
            reach, again = layers[layer, _TAPS] * channels, new + layers[layer + 1, _TAPS] * outputs
            kernel, bias = layers[layer, _KERNEL], layers[layer, _KERNEL] + outputs * reach
            skip, least = layers[layer, _SKIP], np.float32(0 if layer + 1 < last else -np.inf)
            for finger in range(fingers):
                run = memory[finger, old + channels : old + channels + reach]
                for output in range(0, outputs, _TOGETHER):
                    row = kernel + output * reach
                    four = _products(
                        weights[row : row + reach],
                        weights[row + reach : row + 2 * reach],
                        weights[row + 2 * reach : row + 3 * reach],
                        weights[row + 3 * reach : row + 4 * reach],
                        run,
                    )
                    for i in range(_TOGETHER):
                        value = max(four[i] + weights[bias + output + i], least)
                        if skip:
                            value += memory[finger, older + output + i]
                        memory[finger, new + output + i] = memory[finger, again + output + i] = value
        for finger in range(fingers):
            results[time - seen, finger] = 1 / (1 + math.exp(-np.float64(memory[finger, new])))


@cache
def _compiled(code: str) -> Callable[..., None]:
    """Return `advance`, compiled for counts of one type, given as numpy's type code, such as h for int16."""
    counts = types.Array(from_dtype(np.dtype(code)), 3, "A", readonly=True)  # any strides, writeable or not
    arrays = (
        types.float64[:, ::1],
        types.float32[:, ::1],
        types.int64,
        types.float32[::1],
        types.int64[:, ::1],
    )
    return compile_function(types.void(counts, *arrays), fastmath=_VECTORIZED)(advance)


@lru_cache(4)  # streams of one detector share the arrays
def _packed(
    layers: tuple[CausalLayer, ...], position_scale: np.float32, step_scale: np.float32
) -> tuple[Times, Floats, int]:
    """Return the table of layers and the weights for `advance`, and the size of a fingertip's memory."""
    whole = np.arange(-_TABLE, _TABLE + 1, dtype=np.float32)
    scales = np.array([position_scale, step_scale])
    size, channels = layers[0].kernel.shape[1] // 2, 0  # the memory begins with the previous counts
    rows, weights = list[list[int]](), [scales, *(np.arcsinh(whole / scale) for scale in scales)]
    for layer in layers:
        taps, inputs, outputs = layer.kernel.shape
        reads, channels = (count + -count % _TOGETHER for count in (inputs, outputs))
        kernel, bias = np.zeros((taps, reads, channels), np.float32), np.zeros(channels, np.float32)
        kernel[:, :inputs, :outputs], bias[:outputs] = layer.kernel, layer.bias
        rows.append([taps, reads, layer.dilation, size, sum(map(len, weights)), layer.skip])
        weights += [kernel.transpose(2, 0, 1).ravel(), bias]
        size += layer.dilation * 2 * taps * reads
    rows.append([1, channels, 1, size, 0, 0])
    return np.array(rows, np.int64), np.concatenate(weights), size + 2 * channels


class TcnStream:
    """State of a TCN for one or more fingertips.

    Before the first sample, the inputs of all layers are 0, as if the recording were zero-padded before each
    convolution, and the first step is 0. This has no effect after `length` samples.

    Args:
        layers: Layers of the network.
        position_scale: Scale of the counts.
        step_scale: Scale of the steps.
        fingers: Number of fingertips.

    Raises:
        ParameterError: if `fingers` is below 1.
    """

    def __init__(
        self,
        layers: Sequence[CausalLayer],
        position_scale: np.float32,
        step_scale: np.float32,
        fingers: int = 1,
    ) -> None:
        check_at_least("TcnStream", "fingers", fingers, 1)
        self._layers, self._weights, size = _packed(tuple(layers), position_scale, step_scale)
        self._memory, self._seen = np.zeros((fingers, size), np.float32), 0  # samples
        self._shape = fingers, layers[0].kernel.shape[1] // 2  # of a sample's counts
        _compiled("h")  # before the first sample

    def push(self, counts: Counts | Reals) -> Reals:
        """Return the probability of slip (n, fingers) of the next zeroed counts (n, fingers, cells).

        Raises:
            ParameterError: if the counts have a wrong shape.
        """
        shape = counts.shape
        if shape[1:] != self._shape:
            expected = f"(n, {self._shape[0]}, {self._shape[1]})"
            raise ParameterError("TcnStream", "shape of the counts", shape, expected)
        results = np.empty(shape[:2])
        kernel = _compiled(counts.dtype.char)
        kernel(counts, results, self._memory, self._seen, self._weights, self._layers)
        self._seen += shape[0]
        return results

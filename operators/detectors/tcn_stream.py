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
from typing import Final, TypeAlias

import numpy as np
from numba import from_dtype, types

from operators.batch import Counts, Reals, Times
from operators.checks import check_at_least
from operators.compilation import compile_function
from operators.detectors.causal_layer import CausalLayer
from operators.detectors.tcn_heads import Heads
from operators.detectors.weights import Floats
from operators.errors import ParameterError

_TAPS, _CHANNELS, _DILATION, _RINGS, _KERNEL, _SKIP = range(6)  # columns of the table of layers
_VECTORIZED: Final = {"reassoc", "contract", "nsz"}  # sums in any order
_TOGETHER: Final = 4  # outputs that are computed together
_TABLE: Final = 2046  # largest step of a 10-bit count; asinh of whole numbers up to it is tabulated
_ENTRIES: Final = 2 * _TABLE + 1
_DENSE: Final = 3  # layers after the features
_HEAD_ROWS: Final = 6  # at the end of the table of layers, if there are heads
_UNKNOWN_DIRECTION: Final = math.pi / math.sqrt(3)  # rad, standard deviation of any direction
_INFINITY: Final = np.float32(np.inf)
_MISSING: Final = CausalLayer(np.zeros((1, 0, 0), np.float32), np.zeros(0, np.float32))  # of a head
_Network: TypeAlias = tuple[tuple[CausalLayer, ...], np.float32, np.float32, Heads]  # with its two scales
_State: TypeAlias = tuple[_Network, Floats, int]


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
def _enter(  # noqa: PLR0917 - a compiled function takes no keywords
    counts: Counts | Reals, time: int, memory: Floats, new: int, again: int, weights: Floats
) -> None:
    """Store a fingertip's counts (cells,), and position and step of each in both slots."""
    cells = len(counts)
    for cell in range(cells):
        count = np.float32(counts[cell])
        step = count - memory[cell] if time > 0 else np.float32(0)
        memory[cell] = count
        memory[new + cell] = memory[again + cell] = _asinh(count, weights, 0)
        memory[new + cells + cell] = memory[again + cells + cell] = _asinh(step, weights, 1)


@compile_function(fastmath=_VECTORIZED)
def _dense_layer(  # noqa: PLR0917 - a compiled function takes no keywords
    memory: Floats, run: int, weights: Floats, layers: Times, layer: int, least: np.float32
) -> None:
    """Compute a dense layer of a head for the inputs from `run` on; no output is below `least`."""
    reach, outputs = layers[layer, _CHANNELS], layers[layer + 1, _CHANNELS]
    kernel, result = layers[layer, _KERNEL], layers[layer + 1, _RINGS]
    bias, inputs = kernel + outputs * reach, memory[run : run + reach]
    for output in range(0, outputs, _TOGETHER):
        row = kernel + output * reach
        four = _products(
            weights[row : row + reach],
            weights[row + reach : row + 2 * reach],
            weights[row + 2 * reach : row + 3 * reach],
            weights[row + 3 * reach : row + 4 * reach],
            inputs,
        )
        for i in range(_TOGETHER):
            memory[result + output + i] = max(four[i] + weights[bias + output + i], least)


@compile_function(fastmath=_VECTORIZED)
def _doubt(  # noqa: PLR0917 - a compiled function takes no keywords
    memory: Floats, features: int, weights: Floats, layers: Times, layer: int, since: int
) -> float:
    """Update the mean of the features, less that of the training data; return its distance : limit.

    The mean begins with the features `since` sample 0.
    """
    count, mean, result = layers[layer, _CHANNELS], layers[layer, _RINGS], layers[layer + 1, _RINGS]
    trained = layers[layer, _KERNEL] + count * count + count
    share = weights[trained + count] if since > 0 else np.float32(1)
    total = np.float32(0)
    for i in range(count):
        total += memory[features + i]
    if not math.isfinite(total):
        return np.nan
    for i in range(count):
        memory[mean + i] += share * (memory[features + i] - weights[trained + i] - memory[mean + i])
    _dense_layer(memory, mean, weights, layers, layer, -_INFINITY)
    distance = np.float32(0)
    for i in range(count):
        distance += memory[result + i] * memory[result + i]
    return float(distance) / float(weights[trained + count + 1])


@compile_function(fastmath=_VECTORIZED)
def _direction(memory: Floats, velocity: int) -> tuple[float, float]:
    """Return direction and standard deviation (rad) of a velocity with the logarithms of its deviations."""
    x, y = float(memory[velocity]), float(memory[velocity + 1])
    across = math.hypot(y * math.exp(memory[velocity + 2]), x * math.exp(memory[velocity + 3]))
    return math.atan2(y, x), min(across / (x * x + y * y), _UNKNOWN_DIRECTION)


@compile_function(fastmath=_VECTORIZED)
def _assess(  # noqa: PLR0917 - a compiled function takes no keywords
    memory: Floats, features: int, time: int, weights: Floats, layers: Times, results: Reals
) -> None:
    """Write doubt, direction and its deviation of each fingertip (3, fingers); NaN without such a head."""
    velocity = len(layers) - _HEAD_ROWS
    whitening = velocity + _DENSE + 1
    since = time - layers[whitening, _DILATION]
    for finger in range(results.shape[1]):
        own, doubt, direction, deviation = memory[finger], np.nan, np.nan, np.nan
        if layers[velocity, _CHANNELS] > 0:
            _dense_layer(own, features, weights, layers, velocity, np.float32(0))
            _dense_layer(own, layers[velocity + 1, _RINGS], weights, layers, velocity + 1, np.float32(0))
            _dense_layer(own, layers[velocity + 2, _RINGS], weights, layers, velocity + 2, -_INFINITY)
            direction, deviation = _direction(own, layers[velocity + 3, _RINGS])
        if layers[whitening, _CHANNELS] > 0 and since >= 0:
            doubt = _doubt(own, features, weights, layers, whitening, since)
        results[0, finger], results[1, finger], results[2, finger] = doubt, direction, deviation


def advance(  # noqa: PLR0917 - a compiled function takes no keywords
    counts: Counts | Reals, results: Reals, memory: Floats, seen: int, weights: Floats, layers: Times
) -> None:
    """Process the next samples.

    Args:
        counts: (n, fingers, cells)
        results: (n, fingers) probability, output; with heads (4 n, fingers), followed by doubt, direction and
            deviation
        memory: (fingers, size) previous counts, then the rings of each layer; changed in place
        seen: Number of samples before.
        weights: (m,) scales of counts and of steps; a table of asinh for each; kernel (outputs, taps,
            inputs) and bias of each layer
        layers: (layers + 1, 6) taps, input channels, dilation, offset of the rings in `memory`, offset of the
            kernel in `weights`, and whether the input of the previous layer is added; the last row is the
            logit. If there are heads, the layers of the velocity, its outputs, the whitening and its
            outputs follow, without channels where a head is missing. The inputs of the whitening are the mean
            features; its dilation is the first sample with a full window, and its weights are followed by the
            mean of the training data, 1 / time constant and the limit
    """
    size, fingers, _ = counts.shape
    assessed = len(results) > size
    last = len(layers) - 1 - (_HEAD_ROWS if assessed else 0)
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
        if assessed:
            features = _slot(layers, last - _DENSE, time)
            _assess(memory, features, time, weights, layers, results[time - seen + size :: size])


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


class _Packing:
    """Table of layers and weights for `advance`, and the size of a fingertip's memory."""

    def __init__(self, size: int) -> None:
        self.rows, self.weights, self.size = list[list[int]](), list[Floats](), size

    def add(self, layers: Sequence[CausalLayer]) -> None:
        """Append layers, each of which reads the outputs of the previous one, then a row for the outputs."""
        rounded = 0
        for layer in layers:
            taps, inputs, outputs = layer.kernel.shape
            channels, rounded = (count + -count % _TOGETHER for count in (inputs, outputs))
            kernel, bias = np.zeros((taps, channels, rounded), np.float32), np.zeros(rounded, np.float32)
            kernel[:, :inputs, :outputs], bias[:outputs] = layer.kernel, layer.bias
            self.rows.append(
                [taps, channels, layer.dilation, self.size, sum(map(len, self.weights)), layer.skip]
            )
            self.weights += [kernel.transpose(2, 0, 1).ravel(), bias]
            self.size += layer.dilation * 2 * taps * channels
        self.rows.append([1, rounded, 1, self.size, 0, 0])
        self.size += 2 * rounded


@lru_cache(4)  # streams of one detector share the arrays
def _packed(
    layers: tuple[CausalLayer, ...], position_scale: np.float32, step_scale: np.float32, heads: Heads
) -> tuple[Times, Floats, int]:
    """Return the table of layers and the weights for `advance`, and the size of a fingertip's memory."""
    whole = np.arange(-_TABLE, _TABLE + 1, dtype=np.float32)
    scales = np.array([position_scale, step_scale])
    packing = _Packing(layers[0].kernel.shape[1] // 2)  # cells
    packing.weights += [scales, *(np.arcsinh(whole / scale) for scale in scales)]
    packing.add(layers)
    if heads:
        packing.add(heads.velocity or [_MISSING] * 3)
        familiar = heads.familiarity
        packing.add([_MISSING if familiar is None else familiar.whitening_layer])
        if familiar is not None:
            packing.rows[-2][_DILATION] = 1 + sum((len(each.kernel) - 1) * each.dilation for each in layers)
            mean = np.zeros(packing.rows[-2][_CHANNELS], np.float32)
            mean[: familiar.mean.size] = familiar.mean
            packing.weights += [mean, np.array([1 / familiar.samples, familiar.limit], np.float32)]
    return np.array(packing.rows, np.int64), np.concatenate(packing.weights), packing.size


class TcnStream:
    """State of a TCN for one or more fingertips; can be pickled.

    Before the first sample, the inputs of all layers are 0, as if the recording were zero-padded before each
    convolution, and the first step is 0. This has no effect after `length` samples.

    Args:
        layers: Layers of the network.
        position_scale: Scale of the counts.
        step_scale: Scale of the steps.
        heads: Heads of the network.
        fingers: Number of fingertips.

    Raises:
        ParameterError: if `fingers` is below 1.
    """

    _results = 1  # of each sample

    def __init__(
        self,
        layers: Sequence[CausalLayer],
        position_scale: np.float32,
        step_scale: np.float32,
        heads: Heads,
        fingers: int = 1,
    ) -> None:
        check_at_least("TcnStream", "fingers", fingers, 1)
        network = tuple(layers), position_scale, step_scale, heads
        size = _packed(*network)[2]
        self.__setstate__((network, np.zeros((fingers, size), np.float32), 0))
        _compiled("h")  # before the first sample

    def __getstate__(self) -> _State:
        return self._network, self._memory, self._seen  # the layers are in the detector's pickle, too

    def __setstate__(self, state: _State) -> None:
        self._network, self._memory, self._seen = state  # `_seen`: samples
        layers = self._network[0]
        self._layers, self._weights, _ = _packed(*self._network)
        self._shape = len(self._memory), layers[0].kernel.shape[1] // 2  # of a sample's counts

    def push(self, counts: Counts | Reals) -> Reals:
        """Return the probability of slip (n, fingers) of the next zeroed counts (n, fingers, cells).

        Raises:
            ParameterError: if the counts have a wrong shape.
        """
        shape = counts.shape
        if shape[1:] != self._shape:
            expected = f"(n, {self._shape[0]}, {self._shape[1]})"
            raise ParameterError("TcnStream", "shape of the counts", shape, expected)
        results = np.empty((shape[0] * self._results, shape[1]))
        kernel = _compiled(counts.dtype.char)
        kernel(counts, results, self._memory, self._seen, self._weights, self._layers)
        self._seen += shape[0]
        return results


class AssessingTcnStream(TcnStream):
    """State of a TCN with heads."""

    _results = 4

    def push(self, counts: Counts | Reals) -> Reals:
        """Return the probability of slip, as without heads."""
        probability: Reals = self.assess(counts)[0]
        return probability

    def assess(self, counts: Counts | Reals) -> Reals:
        """Return probability, doubt, direction and deviation (4, n, fingers), as `Assessed` scores have them.

        Raises:
            ParameterError: if the counts have a wrong shape.
        """
        return super().push(counts).reshape(4, -1, counts.shape[1])

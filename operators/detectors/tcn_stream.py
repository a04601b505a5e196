"""The TCN sample by sample: cached causal convolutions, compiled.

A layer of d times dilated taps sees every d-th of its inputs. These are kept in d interleaved rings, each
value written twice, `taps` slots apart; so what the taps see is always one contiguous run, oldest first, and
a layer is one product of a matrix and a vector. A ring of 4 taps after its inputs 0 to 5::

    4 5 2 3 4 5 2 3       the newest, 5, stands in slots 1 and 5; the run 2 3 4 5 begins behind the first

A sample's arithmetic depends neither on how many samples nor on how many fingertips are given at once.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import numpy as np
from numba import njit, types

from operators.batch import BAROMETERS, Counts, Reals, Times
from operators.detectors.weights import Floats
from operators.errors import ParameterError

if TYPE_CHECKING:
    from numba.core.typing.templates import Signature

    from operators.detectors.tcn import Tcn

Function = TypeVar("Function", bound=Callable[..., Any])

_TAPS, _CHANNELS, _DILATION, _RINGS, _KERNEL, _SKIP = range(6)  # columns of the table of layers
_SIGNATURES: Final = [
    types.boolean(
        types.Array(scalar, 3, "A", readonly=True),  # any strides; what may be written to is taken as well
        types.float64[:, ::1],
        types.float32[:, ::1],
        types.int64,
        types.float32[::1],
        types.int64[:, ::1],
    )
    for scalar in (types.int16, types.float64)
]


def _compiled(signatures: "list[Signature] | None" = None) -> Callable[[Function], Function]:
    """As machine code, kept on disk, that lets other threads run; its sums are taken on vector units."""
    sums = {"reassoc", "contract", "nsz"}
    decorate = njit(signatures, cache=True, nogil=True, error_model="numpy", fastmath=sums)
    return cast("Callable[[Function], Function]", decorate)


@_compiled()
def _slot(layers: Times, layer: int, time: int) -> int:
    """Where in memory a layer's input of that time stands; it does again taps * channels further on."""
    taps, dilation = layers[layer, _TAPS], layers[layer, _DILATION]
    slot = time % dilation * 2 * taps + time // dilation % taps
    place: int = layers[layer, _RINGS] + slot * layers[layer, _CHANNELS]
    return place


@_compiled()
def _product(row: Floats, run: Floats) -> np.float32:
    """As np.dot; its call of BLAS would take longer than the sum."""
    value = np.float32(0)
    for i in range(len(run)):
        value += row[i] * run[i]
    return value


@_compiled(_SIGNATURES)  # when this module is loaded: the first sample must not wait
def advance(  # noqa: PLR0917 - a compiled function takes no keywords
    counts: Counts | Reals, probability: Reals, memory: Floats, seen: int, weights: Floats, layers: Times
) -> bool:
    """Take the next samples; False if their shape is not the memory's, and nothing was done.

    Args:
        counts: (n, fingers, 6)
        probability: (n, fingers), to be written.
        memory: (fingers, size) the counts before, then each layer's rings; changed in place.
        seen: how many samples came before.
        weights: (m,) scales of counts and of steps; each layer's kernel (outputs, taps, inputs) and bias.
        layers: (layers + 1, 6) taps, channels of the input, dilation, where in memory the rings begin, where
            in weights the kernel does, and whether the input of the layer before is added. The last row is
            where the logit goes.
    """
    size, fingers, cells = counts.shape
    if fingers != len(memory) or cells != BAROMETERS:
        return False
    last = len(layers) - 1
    for time in range(seen, seen + size):
        old = new = _slot(layers, 0, time)
        again = new + layers[0, _TAPS] * layers[0, _CHANNELS]
        for finger in range(fingers):
            for cell in range(cells):
                count = np.float32(counts[time - seen, finger, cell])
                before = memory[finger, cell] if time > 0 else count
                memory[finger, cell] = count
                position, step = math.asinh(count / weights[0]), math.asinh((count - before) / weights[1])
                memory[finger, new + cell] = memory[finger, again + cell] = position
                memory[finger, new + cells + cell] = memory[finger, again + cells + cell] = step
        for layer in range(last):
            older, old, new = old, new, _slot(layers, layer + 1, time)
            channels, outputs = layers[layer, _CHANNELS], layers[layer + 1, _CHANNELS]
            reach, again = layers[layer, _TAPS] * channels, new + layers[layer + 1, _TAPS] * outputs
            kernel, bias = layers[layer, _KERNEL], layers[layer, _KERNEL] + outputs * reach
            skip, least = layers[layer, _SKIP], np.float32(0 if layer + 1 < last else -np.inf)
            for finger in range(fingers):
                run = memory[finger, old + channels : old + channels + reach]
                for output in range(outputs):
                    row = weights[kernel + output * reach : kernel + (output + 1) * reach]
                    value = _product(row, run) + weights[bias + output]
                    value = max(value, least)
                    if skip:
                        value += memory[finger, older + output]
                    memory[finger, new + output] = memory[finger, again + output] = value
        for finger in range(fingers):
            probability[time - seen, finger] = 1 / (1 + math.exp(-np.float64(memory[finger, new])))
    return True


class TcnStream:
    """A TCN at work on some fingertips, a fingertip's samples in order; pickles with what it remembers.

    Before the first sample, the inputs of every layer are 0, as if a whole recording were padded with zeros
    before each convolution; the first sample's step is 0. That is forgotten after `length` samples.

    Raises:
        ParameterError: if there is no fingertip.
    """

    def __init__(self, tcn: "Tcn", fingers: int = 1) -> None:
        if fingers < 1:
            raise ParameterError("TcnStream", "fingers", fingers, "at least 1")
        rows, weights = list[list[int]](), [np.array([tcn.position_scale, tcn.step_scale])]
        memory = BAROMETERS
        for layer in tcn.layers:
            taps, channels, _ = layer.kernel.shape
            rows.append([taps, channels, layer.dilation, memory, sum(map(len, weights)), layer.skip])
            weights += [layer.kernel.transpose(2, 0, 1).ravel(), layer.bias]
            memory += layer.dilation * 2 * taps * channels
        rows.append([1, 1, 1, memory, 0, 0])
        self._layers = np.array(rows, np.int64)
        self._weights = np.concatenate(weights)
        self._memory = np.zeros((fingers, memory + 2), np.float32)
        self._seen = 0  # samples

    def push(self, counts: Counts | Reals) -> Reals:
        """The probability of slip of each of the next samples (n, fingers, 6) of zeroed counts; (n, fingers).

        Raises:
            ParameterError: if the counts have another shape.
        """
        if counts.dtype.char != "h":  # int16
            counts = counts.astype(np.float64)
        fingers = len(self._memory)
        probability = np.empty((len(counts), fingers))
        arrays = self._weights, self._layers
        if counts.ndim != 3 or not advance(counts, probability, self._memory, self._seen, *arrays):  # noqa: PLR2004
            raise ParameterError("TcnStream", "shape of the counts", counts.shape, f"(n, {fingers}, 6)")
        self._seen += len(counts)
        return probability

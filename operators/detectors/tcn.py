"""Temporal convolutional network (TCN), the default detector; streaming and windowed inference agree."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, Counts, Reals
from operators.detectors.weights import CausalLayer, Floats, ForOneFingertip, Weights, check_weights
from operators.errors import InputError, ParameterError
from operators.steps import Steps

_MAX_DILATION: Final = 1000  # samples, largest plausible dilation
_DENSE: Final = ("dense0", "dense1", "out")  # names of the dense layers


class Tcn(ForOneFingertip):
    """Detect slip with a causal convolutional network that can process samples one by one.

    Residual blocks of two causal convolutions are followed by three dense layers, the last with a sigmoid.
    The features of a sample are asinh(x / position_scale) of the counts of each cell and
    asinh((x - previous x) / step_scale) of their steps. A ReLU follows each convolution and each dense layer
    but the last. The second convolution of a block then adds the block's input, if it has the same number of
    channels. There is no padding, so the receptive field is the window, and `score`, `steps` and a
    convolution over a whole recording compute the same function. `steps` is by far the fastest.

    Args:
        weights: ``conv{i}/kernel`` (taps, in, filters) and ``conv{i}/bias``, two per block; ``dense0/...``,
            ``dense1/...``, ``out/...``, kernels (in, out); ``dilations`` (blocks,), ``position_scale`` and
            ``step_scale`` (1,) in counts. Batch norm is folded in. `shapes` lists them; further
            arrays are ignored.

    Attributes:
        cells: Number of cells.

    Raises:
        InputError: if an array is missing, has a wrong shape, is not finite, or is out of range.
    """

    name = "tcn"
    in_counts = ("position_scale", "step_scale")

    def __init__(self, weights: Weights) -> None:
        _check(weights)
        self.layers = _layers(weights)
        self.cells = self.layers[0].kernel.shape[1] // 2
        self.position_scale = np.float32(weights["position_scale"][0])
        self.step_scale = np.float32(weights["step_scale"][0])
        self._taps = list[NDArray[np.intp]]()  # per layer, (steps, taps): inputs of each step
        steps = np.zeros(1, np.intp)  # required steps of the layer's output, counted from the newest
        for layer in reversed(self.layers):
            seen = steps[:, None] - layer.dilation * np.arange(len(layer.kernel))[::-1]
            steps = np.unique(seen)
            self._taps.insert(0, steps.searchsorted(seen))
        self._steps = steps  # (steps,) at most 0: samples whose features are required
        self.length = 2 - int(steps[0])  # the oldest step needs the sample before it

    def score(self, windows: Counts | Reals) -> Reals:
        """Return the probability of slip of each window (n, length, cells) of zeroed counts; (n,)."""
        counts = windows.astype(np.float32, order="C")
        newest = self._steps + self.length - 1
        inputs = [self._features(counts[:, newest], counts[:, newest - 1])]  # per layer (n, steps, in)
        for number, (layer, taps) in enumerate(zip(self.layers, self._taps, strict=True)):
            kernel: Floats = layer.kernel.reshape(-1, layer.bias.size)
            seen: Floats = inputs[-1].take(taps, axis=1).reshape(len(counts), len(taps), len(kernel))
            values: Floats = seen @ kernel + layer.bias  # one product per window, for identical rounding
            if number + 1 < len(self.layers):
                np.maximum(values, 0, out=values)
            if layer.skip:
                same = self._taps[number - 1][taps[:, -1], -1]  # newest input of the newest tap
                values += inputs[-2][:, same]
            inputs.append(values)
        return 1 / (1 + np.exp(-inputs[-1][:, 0, 0].astype(np.float64)))

    def steps(self, cells: int) -> Steps:
        """Return the step from zeroed touch to scores.

        Raises:
            ParameterError: if the network is for another number of cells.
        """
        from operators.detectors.tcn_stream import tcn_steps

        if cells != self.cells:
            raise ParameterError(type(self).__name__, "cells", cells, f"{self.cells}, as in training")
        return tcn_steps(self.layers, self.position_scale, self.step_scale, self.length)

    def _features(self, counts: Floats, before: Floats) -> Floats:
        parts = np.arcsinh(counts / self.position_scale), np.arcsinh((counts - before) / self.step_scale)
        return np.concatenate(parts, axis=2)  # (n, steps, 2 cells)


def _layers(weights: Weights) -> list[CausalLayer]:
    def array(name: str) -> Floats:
        return weights[name].astype(np.float32)

    layers = list[CausalLayer]()
    for block, dilation in enumerate(weights["dilations"].tolist()):
        first, second = f"conv{2 * block}", f"conv{2 * block + 1}"
        kernel = array(f"{first}/kernel")
        skip = kernel.shape[1] == kernel.shape[2]
        layers.append(CausalLayer(kernel, array(f"{first}/bias"), dilation))
        layers.append(CausalLayer(array(f"{second}/kernel"), array(f"{second}/bias"), dilation, skip))
    return [*layers, *(CausalLayer(array(f"{name}/kernel")[None], array(f"{name}/bias")) for name in _DENSE)]


def shapes(
    taps: int, filters: int, units: int, blocks: int, cells: int = BAROMETERS
) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of weights."""
    result: dict[str, tuple[int, ...]] = {"position_scale": (1,), "step_scale": (1,), "dilations": (blocks,)}
    for conv in range(2 * blocks):
        result[f"conv{conv}/kernel"] = (taps, filters if conv else 2 * cells, filters)
        result[f"conv{conv}/bias"] = (filters,)
    for name, kernel in {"dense0": (filters, units), "dense1": (units, units), "out": (units, 1)}.items():
        result[f"{name}/kernel"], result[f"{name}/bias"] = kernel, kernel[1:]
    return result


def _check(weights: Weights) -> None:
    none = np.empty(0)
    kernel, dense = (weights.get(f"{name}/kernel", none).shape for name in ("conv0", "dense0"))
    taps, inputs, filters = (max(size, 1) for size in (*kernel, 1, 1, 1)[:3])
    units, dilations = max((*dense, 1, 1)[1], 1), weights.get("dilations", none)
    blocks = dilations.size
    check_weights("Tcn", weights, shapes(taps, filters, units, blocks, max(inputs // 2, 1)))
    whole = blocks and dilations.dtype.kind in "iu"
    if not (whole and dilations.min() >= 1 and dilations.max() <= _MAX_DILATION):
        raise _error(f"dilations is {dilations.tolist()}, must be whole numbers from 1 to {_MAX_DILATION}")
    if (surplus := f"conv{2 * blocks}/kernel") in weights:
        raise _error(f"{surplus} is not expected: dilations has length {blocks}")
    for name in ("position_scale", "step_scale"):
        if not weights[name][0] > 0:
            raise _error(f"{name} is {weights[name][0]}, must be above 0")


def _error(reason: str) -> InputError:
    return InputError("Tcn weights", reason)

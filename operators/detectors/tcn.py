"""Our temporal convolutional network, the default detector: one that can be streamed exactly."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, Counts, Reals
from operators.detectors.weights import Floats, Weights, check
from operators.errors import InputError

if TYPE_CHECKING:
    from operators.detectors.tcn_stream import TcnStream

FEATURES: Final = 2 * BAROMETERS  # of one sample: where each barometer stands, and its step since the last
_FURTHEST: Final = 1000  # samples, a dilation: what lies above is a damaged file


@dataclass(frozen=True)
class Layer:
    """A causal convolution over the steps before it; a dense layer is one of a single tap."""

    kernel: Floats  # (taps, inputs, outputs), the oldest tap first
    bias: Floats  # (outputs,)
    dilation: int = 1  # steps between taps
    skip: bool = False  # after the ReLU, the input of the layer before is added


class Tcn:
    """Residual blocks of two causal convolutions each, and three dense layers, the last a sigmoid.

    Features of a sample are asinh(x / position_scale) of its six counts, then asinh((x - x_before) /
    step_scale) of their steps. A ReLU follows each convolution and each dense layer but the last, and then,
    in the second convolution of a block, the block's input is added, where it has as many channels. Nothing
    is padded: the receptive field is the window. So `score`, a convolution over a whole recording, and
    `stream` are the same function; the last is by far the cheapest.

    Args:
        weights: ``conv{i}/kernel`` (taps, in, filters) and ``conv{i}/bias``, two to a block;
            ``dense0/...``, ``dense1/...``, ``out/...``, kernels (in, out); ``dilations`` (blocks,),
            ``position_scale`` and ``step_scale`` (1,) in counts. Norms are folded in. `shapes` names them.

    Raises:
        InputError: an array is missing, has another shape, is not finite, or is out of range.
    """

    name = "tcn"

    def __init__(self, weights: Weights) -> None:
        _check(weights)
        self.layers = _layers(weights)
        self.position_scale = np.float32(weights["position_scale"][0])
        self.step_scale = np.float32(weights["step_scale"][0])
        self._taps = list[NDArray[np.intp]]()  # by layer, (steps, taps): what each of its steps sees
        steps = np.zeros(1, np.intp)  # back from the newest, those of the layer's output that are needed
        for layer in reversed(self.layers):
            seen = steps[:, None] - layer.dilation * np.arange(len(layer.kernel))[::-1]
            steps = np.unique(seen)
            self._taps.insert(0, steps.searchsorted(seen))
        self._steps = steps  # (steps,) 0 and below: the samples whose features are needed
        self.length = 2 - int(steps[0])  # the step of the oldest needs a sample more

    def score(self, windows: Counts | Reals) -> Reals:
        """The probability of slip of each window (n, length, 6) of zeroed counts; (n,)."""
        counts = windows.astype(np.float32, order="C")
        newest = self._steps + self.length - 1
        inputs = [self._features(counts[:, newest], counts[:, newest - 1])]  # of each layer (n, steps, in)
        for number, (layer, taps) in enumerate(zip(self.layers, self._taps, strict=True)):
            kernel: Floats = layer.kernel.reshape(-1, layer.bias.size)
            seen: Floats = inputs[-1].take(taps, axis=1).reshape(len(counts), len(taps), len(kernel))
            values: Floats = seen @ kernel + layer.bias  # a product for each window, so that all round alike
            if number + 1 < len(self.layers):
                np.maximum(values, 0, out=values)
            if layer.skip:
                same = self._taps[number - 1][taps[:, -1], -1]  # the newest that the newest tap saw
                values += inputs[-2][:, same]
            inputs.append(values)
        return 1 / (1 + np.exp(-inputs[-1][:, 0, 0].astype(np.float64)))

    def stream(self, fingers: int = 1) -> "TcnStream":
        """A new stream that has seen nothing, of `fingers` fingertips that are sampled together."""
        from operators.detectors.tcn_stream import TcnStream  # noqa: PLC0415 - loads numba

        return TcnStream(self, fingers)

    def _features(self, counts: Floats, before: Floats) -> Floats:
        parts = np.arcsinh(counts / self.position_scale), np.arcsinh((counts - before) / self.step_scale)
        return np.concatenate(parts, axis=2)  # (n, steps, 12)


class GraspTcn(Tcn):
    """The same network, trained on grasps as well as on strokes: slip is what slides in the hand."""

    name = "tcn_grasp"


def _layers(weights: Weights) -> list[Layer]:
    def array(name: str) -> Floats:
        return weights[name].astype(np.float32)

    layers = list[Layer]()
    for block, dilation in enumerate(weights["dilations"].tolist()):
        first, second = f"conv{2 * block}", f"conv{2 * block + 1}"
        kernel = array(f"{first}/kernel")
        skip = kernel.shape[1] == kernel.shape[2]
        layers.append(Layer(kernel, array(f"{first}/bias"), dilation))
        layers.append(Layer(array(f"{second}/kernel"), array(f"{second}/bias"), dilation, skip))
    dense = ("dense0", "dense1", "out")
    return [*layers, *(Layer(array(f"{name}/kernel")[None], array(f"{name}/bias")) for name in dense)]


def shapes(taps: int, filters: int, units: int, blocks: int) -> dict[str, tuple[int, ...]]:
    """The shape of each array of weights."""
    result: dict[str, tuple[int, ...]] = {"position_scale": (1,), "step_scale": (1,), "dilations": (blocks,)}
    for conv in range(2 * blocks):
        result[f"conv{conv}/kernel"] = (taps, filters if conv else FEATURES, filters)
        result[f"conv{conv}/bias"] = (filters,)
    for name, kernel in {"dense0": (filters, units), "dense1": (units, units), "out": (units, 1)}.items():
        result[f"{name}/kernel"], result[f"{name}/bias"] = kernel, kernel[1:]
    return result


def _check(weights: Weights) -> None:
    sizes = list[int]()
    for name, like in (("conv0/kernel", "(taps, 12, filters)"), ("dense0/kernel", "(filters, units)")):
        shape = weights[name].shape if name in weights else None
        if shape is None:
            raise _refused(f"{name} is missing")
        if len(shape) != len(like.split()) or 0 in shape:
            raise _refused(f"{name} has shape {shape}, must be {like}")
        sizes += shape[0], shape[-1]
    taps, filters, _, units = sizes
    blocks = weights["dilations"].size if "dilations" in weights else 0
    check("Tcn", weights, shapes(taps, filters, units, blocks))
    dilations = weights["dilations"]
    if not blocks or dilations.dtype.kind not in "iu" or dilations.min() < 1 or dilations.max() > _FURTHEST:
        raise _refused(f"dilations is {dilations.tolist()}, must hold whole numbers from 1 to {_FURTHEST}")
    if (surplus := f"conv{2 * blocks}/kernel") in weights:
        raise _refused(f"{surplus} is one too many for the {blocks} blocks that dilations names")
    for name in ("position_scale", "step_scale"):
        if not weights[name][0] > 0:
            raise _refused(f"{name} is {weights[name][0]}, must be above 0")


def _refused(reason: str) -> InputError:
    return InputError("Tcn weights", reason)

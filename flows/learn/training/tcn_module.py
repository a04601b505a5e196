"""Our temporal convolutional network as a torch module: the whole model in one file."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from flows.learn.training.recipe import Recipe
from operators.batch import BAROMETERS


class DenseTcn(nn.Module):
    """Slip at every sample of a sequence.

    Features of a sample are asinh(x / position_scale) and asinh(dx / step_scale) of each barometer, dx the
    step from the sample before: the signal matters from one count (noise) to 500 (saturation). Blocks of two
    causal convolutions, batch norm and ReLU, with an identity skip where the widths agree, two dense layers.
    Batch norm becomes part of the weights when the network is exported, so a sample costs only products.
    """

    def __init__(self, recipe: Recipe) -> None:
        super().__init__()
        self.recipe = recipe
        convs: list[_Layer] = []
        width = 2 * BAROMETERS
        for dilation in recipe.dilations:
            for _ in range(2):
                convs.append(_Layer(width, recipe.filters, recipe.taps, dilation))
                width = recipe.filters
        dense = [_Layer(width, recipe.units), _Layer(recipe.units, recipe.units)]
        self._convs, self._dense = tuple(convs), tuple(dense)  # typed
        self.convs, self.dense = nn.ModuleList(convs), nn.ModuleList(dense)  # known to torch
        self.out = nn.Conv1d(recipe.units, 1, 1)

    def forward(self, counts: Tensor) -> Tensor:
        """The logit of slip (b, n) of counts (b, 6, n); mask the first, which see the padding before."""
        steps = functional.pad(counts[..., 1:] - counts[..., :-1], (1, 0))
        positions = torch.asinh(counts / self.recipe.position_scale)
        x = torch.cat([positions, torch.asinh(steps / self.recipe.step_scale)], 1)  # (b, 12, n)
        for first, second in zip(self._convs[::2], self._convs[1::2], strict=True):
            y = functional.dropout1d(second(first(x)), self.recipe.dropout, self.training)
            x = y + x if y.shape == x.shape else y  # (b, filters, n)
        for layer in self._dense:
            x = layer(x)
        logit: Tensor = self.out(x)[:, 0]  # (b, n)
        return logit

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The weights as `operators.detectors.Tcn` takes them, batch norm folded in."""
        arrays: dict[str, NDArray[Any]] = {
            "dilations": np.array(self.recipe.dilations, np.int64),
            "position_scale": np.array([self.recipe.position_scale], np.float32),
            "step_scale": np.array([self.recipe.step_scale], np.float32),
        }
        for number, layer in enumerate(self._convs):
            arrays[f"conv{number}/kernel"], arrays[f"conv{number}/bias"] = layer.folded()
        for number, layer in enumerate(self._dense):
            kernel, arrays[f"dense{number}/bias"] = layer.folded()
            arrays[f"dense{number}/kernel"] = kernel[0]
        arrays["out/kernel"] = _array(self.out.weight[:, :, 0].T)
        arrays["out/bias"] = _array(self.out.bias)
        return arrays


class _Layer(nn.Module):
    """A causal convolution, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, taps: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv1d(inputs, outputs, taps, dilation=dilation)
        self.norm = nn.BatchNorm1d(outputs)
        self._past = (taps - 1) * dilation

    def forward(self, x: Tensor) -> Tensor:
        """(b, inputs, n) to (b, outputs, n)."""
        y: Tensor = self.norm(self.conv(functional.pad(x, (self._past, 0))))
        return functional.relu(y)

    def folded(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Kernel (taps, inputs, outputs) and bias (outputs,) with the norm's running statistics in them."""
        norm = self.norm
        assert norm.running_mean is not None
        assert norm.running_var is not None
        scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)  # (outputs,)
        kernel = self.conv.weight * scale[:, None, None]  # (outputs, inputs, taps)
        bias = self.conv.bias
        assert bias is not None
        return _array(kernel.permute(2, 1, 0)), _array((bias - norm.running_mean) * scale + norm.bias)


def _array(tensor: Tensor | None) -> NDArray[Any]:
    assert tensor is not None
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32)

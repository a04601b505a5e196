"""Temporal convolutional network as a torch module, for training."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import Arrays
from flows.learn.training.training_loop import Network
from operators.batch import BAROMETERS
from operators.detectors.tcn import Tcn


class DenseTcn(Network):
    """Network that computes the logit of slip at every sample of a sequence.

    Features of a sample are asinh(x / position_scale) and asinh(dx / step_scale) of each barometer, dx the
    step from the previous sample: the signal matters from one count (noise) to 500 (saturation). Blocks
    of two causal convolutions with batch norm and ReLU, and an identity skip if the widths agree; then dense
    layers. Batch norm is folded into the exported weights.

    Args:
        recipe: Size of the network.
        cells: Number of cells.
        folded: Leave batch norm out: it is folded into the weights to start from.
    """

    def __init__(self, recipe: Recipe, cells: int = BAROMETERS, *, folded: bool = False) -> None:
        super().__init__()
        self.recipe = recipe
        convs: list[_Layer] = []
        width = 2 * cells
        for dilation in recipe.dilations:
            for _ in range(2):
                convs.append(_Layer(width, recipe.filters, recipe.taps, dilation, folded=folded))
                width = recipe.filters
        dense = [_Layer(inputs, recipe.units, folded=folded) for inputs in (width, recipe.units)]
        self._convs, self._dense = tuple(convs), tuple(dense)  # typed
        self.convs, self.dense = nn.ModuleList(convs), nn.ModuleList(dense)  # registered with torch
        self.out = nn.Conv1d(recipe.units, 1, 1)

    @classmethod
    def of_detector(cls, tcn: Tcn) -> "DenseTcn":
        """Return the network with the weights of a detector, which contain its batch norms."""
        network = cls(Recipe.of(tcn), tcn.cells, folded=True)
        targets = [*(layer.conv for layer in (*network._convs, *network._dense)), network.out]
        for target, layer in zip(targets, tcn.layers, strict=True):
            assert target.bias is not None
            target.weight.data = torch.as_tensor(layer.kernel.transpose(2, 1, 0).copy())
            target.bias.data = torch.as_tensor(layer.bias.copy())
        return network.eval()

    def forward(self, counts: Tensor) -> Tensor:
        """Return the logit of slip (b, n) of counts (b, cells, n); the first ones depend on the padding."""
        steps = torch.diff(counts, dim=2, prepend=counts[..., :1])
        scale = self.recipe
        x = torch.cat([torch.asinh(counts / scale.position_scale), torch.asinh(steps / scale.step_scale)], 1)
        for first, second in zip(self._convs[::2], self._convs[1::2], strict=True):
            y = functional.dropout1d(second(first(x)), self.recipe.dropout, self.training)
            x = y + x if first.conv.in_channels == second.conv.out_channels else y  # (b, filters, n)
        for layer in self._dense:
            x = layer(x)
        logit: Tensor = self.out(x)[:, 0]
        return logit

    def arrays(self) -> Arrays:
        """Return the weights as `operators.detectors.Tcn` takes them, batch norm folded in."""
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
    """Causal convolution, batch norm unless it is folded, and ReLU."""

    def __init__(self, inputs: int, outputs: int, taps: int = 1, dilation: int = 1, *, folded: bool) -> None:
        super().__init__()
        self.conv = nn.Conv1d(inputs, outputs, taps, dilation=dilation)
        self.norm = None if folded else nn.BatchNorm1d(outputs)
        self.past = (taps - 1) * dilation

    def forward(self, x: Tensor) -> Tensor:
        """Map (b, inputs, n) to (b, outputs, n), with zeros before the first step."""
        y: Tensor = self.conv(functional.pad(x, (self.past, 0)))
        return functional.relu(y if self.norm is None else self.norm(y))

    def folded(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return kernel (taps, inputs, outputs) and bias (outputs,) with the running statistics folded in."""
        norm = self.norm
        if norm is None:
            return _array(self.conv.weight.permute(2, 1, 0)), _array(self.conv.bias)
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

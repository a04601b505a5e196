"""Temporal convolutional network as a torch module, for training and export."""

from typing import Any, Final, Self

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

_DENSE: Final = 3  # number of dense layers at the end


class DenseTcn(Network):
    """Network that computes the logit of slip at every sample of a sequence.

    Features of a sample are asinh(x / position_scale) and asinh(dx / step_scale) of each barometer, dx the
    step from the previous sample: the signal matters from one count (noise) to 500 (saturation). Blocks
    of two causal convolutions with batch norm and ReLU, and an identity skip if the widths agree; then dense
    layers. Batch norm is folded into the exported weights.

    Args:
        recipe: Size of the network.
        cells: Number of cells.
        fixed_norms: Batch norms always use their running statistics, also in training.
    """

    def __init__(self, recipe: Recipe, cells: int = BAROMETERS, *, fixed_norms: bool = False) -> None:
        super().__init__()
        self.recipe, self._fixed_norms = recipe, fixed_norms
        convs: list[_Layer] = []
        width = 2 * cells
        for dilation in recipe.dilations:
            for _ in range(2):
                convs.append(_Layer(width, recipe.filters, recipe.taps, dilation))
                width = recipe.filters
        dense = [_Layer(width, recipe.units), _Layer(recipe.units, recipe.units)]
        self._convs, self._dense = tuple(convs), tuple(dense)  # typed
        self.convs, self.dense = nn.ModuleList(convs), nn.ModuleList(dense)  # registered with torch
        self.out = nn.Conv1d(recipe.units, 1, 1)

    @classmethod
    def of_detector(cls, tcn: Tcn) -> "DenseTcn":
        """Return the network with the weights of a detector; its batch norms are identities and stay so."""
        convs = tcn.layers[:-_DENSE]
        taps, _, filters = convs[0].kernel.shape
        network = cls(
            Recipe(
                filters=filters,
                units=tcn.layers[-1].kernel.shape[1],
                taps=taps,
                dilations=[layer.dilation for layer in convs[::2]],
                crop=tcn.length + 1,
                position_scale=float(tcn.position_scale),
                step_scale=float(tcn.step_scale),
            ),
            tcn.cells,
            fixed_norms=True,
        )
        targets = [*(layer.conv for layer in (*network._convs, *network._dense)), network.out]
        for target, layer in zip(targets, tcn.layers, strict=True):
            assert target.bias is not None
            target.weight.data = torch.as_tensor(layer.kernel.transpose(2, 1, 0).copy())
            target.bias.data = torch.as_tensor(layer.bias.copy())
        for norm in (layer.norm for layer in (*network._convs, *network._dense)):
            assert norm.running_var is not None
            norm.running_var.fill_(1 - norm.eps)
            norm.requires_grad_(requires_grad=False)
        return network.eval()

    def train(self, mode: bool = True) -> Self:  # noqa: FBT001, FBT002 - of torch
        """Switch dropout and, unless they are fixed, batch norms to training."""
        super().train(mode)
        if self._fixed_norms:
            for layer in (*self._convs, *self._dense):
                layer.norm.eval()
        return self

    def forward(self, counts: Tensor) -> Tensor:
        """Return the logit of slip (b, n) of counts (b, cells, n); the first ones depend on the padding."""
        return self.classified(self.hidden(counts))

    def newest(self, windows: Tensor) -> Tensor:
        """Return the probability of slip (b,) at the newest sample of windows (b, length, cells) of counts.

        Convolutions without padding compute only the steps that the newest sample depends on.
        """
        counts = windows.transpose(1, 2)
        features = self._features(counts[..., 1:], counts[..., :-1])  # (b, 2 cells, length - 1)
        return torch.sigmoid(self.classified(self._convolved(features, padded=False))[:, -1])

    def _features(self, counts: Tensor, before: Tensor) -> Tensor:
        positions = torch.asinh(counts / self.recipe.position_scale)
        return torch.cat([positions, torch.asinh((counts - before) / self.recipe.step_scale)], 1)

    def hidden(self, counts: Tensor) -> Tensor:
        """Return the output of the convolutions (b, filters, n) for counts (b, cells, n)."""
        before = torch.cat([counts[..., :1], counts[..., :-1]], 2)
        return self._convolved(self._features(counts, before), padded=True)

    def classified(self, hidden: Tensor) -> Tensor:
        """Return the logits (b, n) of outputs of the convolutions (b, filters, n)."""
        x = hidden
        for layer in self._dense:
            x = layer(x)
        logit: Tensor = self.out(x)[:, 0]
        return logit

    def _convolved(self, x: Tensor, *, padded: bool) -> Tensor:
        """Return the output of the convolutions for features (b, 2 cells, n); shorter without padding."""
        for first, second in zip(self._convs[::2], self._convs[1::2], strict=True):
            y = second(first(x, padded=padded), padded=padded)
            y = functional.dropout1d(y, self.recipe.dropout, self.training)
            same = first.conv.in_channels == second.conv.out_channels
            skipped = 0 if padded else first.past + second.past
            x = y + x[..., skipped:] if same else y  # (b, filters, n)
        return x

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
    """Causal convolution, batch norm and ReLU."""

    def __init__(self, inputs: int, outputs: int, taps: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv1d(inputs, outputs, taps, dilation=dilation)
        self.norm = nn.BatchNorm1d(outputs)
        self.past = (taps - 1) * dilation

    def forward(self, x: Tensor, *, padded: bool = False) -> Tensor:
        """Map (b, inputs, n) to (b, outputs, n), with zeros before the first step, or n - past without."""
        y: Tensor = self.norm(self.conv(functional.pad(x, (self.past, 0)) if padded else x))
        return functional.relu(y)

    def folded(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return kernel (taps, inputs, outputs) and bias (outputs,) with the running statistics folded in."""
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

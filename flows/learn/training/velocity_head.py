"""Head of the TCN that estimates the sliding velocity, with its uncertainty."""

from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

_UNITS: Final = 32  # of each hidden layer
_PLANE: Final = 2  # x and y
_SCALE: Final = (
    60.0  # mm/s, about the speed of a stroke: the last layer computes velocity and deviation in it
)
_LEAST: Final = -4.0  # smallest log deviation that lowers the loss, about 1 mm/s: less is noise of the truth


class VelocityHead(nn.Module):
    """Dense layers from the output of the convolutions to velocity and uncertainty.

    The outputs are vx and vy in the fingertip's plane, and the log of the standard deviation of each.

    Args:
        width: Channels of the convolutions.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        layers = nn.Conv1d(width, _UNITS, 1), nn.Conv1d(_UNITS, _UNITS, 1), nn.Conv1d(_UNITS, 2 * _PLANE, 1)
        self._layers = layers  # typed
        self.layers = nn.ModuleList(layers)  # registered with torch

    def forward(self, hidden: Tensor) -> Tensor:
        """Return velocity and log deviations (b, 4, n), in 60 mm/s, of outputs (b, width, n)."""
        first, second, last = self._layers
        x: Tensor = last(functional.relu(second(functional.relu(first(hidden)))))
        return x

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the weights, the outputs in mm/s and log mm/s."""
        arrays = dict[str, NDArray[Any]]()
        for name, layer in zip(("velocity0", "velocity1", "velocity"), self._layers, strict=True):
            assert layer.bias is not None
            arrays[f"{name}/kernel"] = _array(layer.weight[..., 0].T)
            arrays[f"{name}/bias"] = _array(layer.bias)
        arrays["velocity/kernel"][:, :_PLANE] *= _SCALE
        arrays["velocity/bias"][:_PLANE] *= _SCALE
        arrays["velocity/bias"][_PLANE:] += np.float32(np.log(_SCALE))
        return arrays


def velocity_loss(found: Tensor, true: Tensor) -> Tensor:
    """Return the negative log likelihood of velocities, as normal distributions, without its constant.

    Args:
        found: Output (b, 4, n) of the head.
        true: Velocities (b, n, 2), mm/s; NaN where they are unknown or nothing slides.
    """
    known = ~true[..., 0].isnan()
    chosen = found.transpose(1, 2)[known]  # (k, 4)
    mean, deviation = chosen[:, :_PLANE], chosen[:, _PLANE:].clamp(min=_LEAST)  # (k, 2) each
    each = deviation + ((true[known] / _SCALE - mean) * torch.exp(-deviation)).square() / 2
    total: Tensor = each.sum() / max(each.numel(), 1)
    return total


def _array(tensor: Tensor) -> NDArray[Any]:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32).copy()

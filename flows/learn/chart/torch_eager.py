"""The default detector as most would run it: the torch module that was trained, eager, on whole windows."""

from typing import Final

import numpy as np
import torch

from flows.learn.training.recipe import Recipe
from flows.learn.training.tcn_module import DenseTcn
from operators.batch import Counts, Reals
from operators.detectors.tcn import Tcn

_DENSE: Final = 3  # of the layers, the last
_EPSILON: Final = 1e-5  # that torch adds to the variance in a batch norm


class TorchEager:
    """`Tcn` by `DenseTcn`, with the same weights; its norms change nothing, as theirs are folded in."""

    name = "torch_eager_windowed"

    def __init__(self, tcn: Tcn) -> None:
        self.length = tcn.length
        self._module = _module(tcn).eval()

    def score(self, windows: Counts | Reals) -> Reals:
        """The probability of slip of each window (n, length, 6) of zeroed counts; (n,)."""
        with torch.inference_mode():
            counts = torch.as_tensor(windows.astype(np.float32, order="C")).transpose(1, 2)
            probability: Reals = torch.sigmoid(self._module(counts)[:, -1]).numpy().astype(np.float64)
        return probability


def _module(tcn: Tcn) -> DenseTcn:
    convs = tcn.layers[:-_DENSE]
    taps, _, filters = convs[0].kernel.shape
    recipe = Recipe(
        filters=filters,
        units=tcn.layers[-1].kernel.shape[1],
        taps=taps,
        dilations=[layer.dilation for layer in convs[::2]],
        crop=tcn.length + 1,
        position_scale=float(tcn.position_scale),
        step_scale=float(tcn.step_scale),
    )
    module = DenseTcn(recipe)
    state = module.state_dict()
    names = [f"convs.{number}.conv" for number in range(len(convs))] + ["dense.0.conv", "dense.1.conv", "out"]
    for name, layer in zip(names, tcn.layers, strict=True):
        state[f"{name}.weight"] = torch.as_tensor(layer.kernel.transpose(2, 1, 0).copy())
        state[f"{name}.bias"] = torch.as_tensor(layer.bias.copy())
    for name in names[:-1]:  # a norm that leaves its input as it is
        variance = f"{name.removesuffix('conv')}norm.running_var"
        state[variance] = torch.full_like(state[variance], 1 - _EPSILON)
    module.load_state_dict(state)
    return module

"""Networks of the paper in PyTorch, for training; the numpy detectors run the exported weights."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from flows.learn.training.recipe import PaperRecipe
from flows.learn.training.trained_model import Arrays
from flows.learn.training.training_loop import Network, set_seed
from operators.batch import BAROMETERS, Reals
from operators.detectors.frequency_cnn import BINS, PARTS, PIXELS

_TAPS: Final = 8
_FILTERS: Final = 12
_UNITS: Final = 24
_BLOCKS: Final = 4
_EPSILON: Final = 1e-3  # of both norms; this and the next are Keras defaults
_MOMENTUM: Final = 0.01  # weight of a batch in the running mean and variance
_TRUNCATED: Final = 0.87962566103423978  # standard deviation of a unit normal that is cut off at 2


def paper_network(mean: Reals, std: Reals, recipe: PaperRecipe) -> "PaperNetwork":
    """Return the network of a recipe with initial weights; this seeds torch's random numbers.

    Kernels are He normal as Keras draws them (cut off at two standard deviations), biases are zero.

    Args:
        mean: (6,) mean of the training counts.
        std: (6,) standard deviation of the training counts.
        recipe: Name of the network, dropout and seed.
    """
    kind = PaperTcnNetwork if recipe.network == "paper_tcn" else FrequencyCnnNetwork
    network = kind(mean, std, recipe.dropout)
    set_seed(recipe.seed)
    for each, values in network.named_parameters():
        if values.ndim > 1:
            deviation = (2 / values[0].numel()) ** 0.5 / _TRUNCATED
            nn.init.trunc_normal_(values, 0, deviation, -2 * deviation, 2 * deviation)
        elif each.endswith("bias"):
            nn.init.zeros_(values)
    return network


class PaperNetwork(Network):
    """Base class of the networks: standardised counts to logits of static and slip."""

    mean: Tensor  # (6,)
    std: Tensor  # (6,)

    def __init__(self, mean: Reals, std: Reals) -> None:
        super().__init__()
        self.register_buffer("mean", torch.as_tensor(mean.astype(np.float32)))
        self.register_buffer("std", torch.as_tensor(std.astype(np.float32)))

    def forward(self, counts: Tensor) -> Tensor:
        """Return the logits (n, 2) of windows of counts (n, 100, 6), newest last."""
        return self.logits((counts - self.mean) / self.std)

    @abstractmethod
    def logits(self, inputs: Tensor) -> Tensor:
        """Return the logits (n, 2) of standardised counts (n, 100, 6)."""

    def arrays(self) -> Arrays:
        """Return the arrays that the detector of this network takes; float32."""
        state: dict[str, Tensor] = self.state_dict()
        found = self.layers({name: values.cpu().numpy().astype(np.float64) for name, values in state.items()})
        found |= {"mean": self.mean.cpu().numpy(), "std": self.std.cpu().numpy()}
        return {name: np.ascontiguousarray(array, np.float32) for name, array in found.items()}

    @abstractmethod
    def layers(self, state: "_State") -> "_Layers":
        """Return kernels, biases and norms of the layers from the state of this module."""


_Array = NDArray[np.float64]
_State = Mapping[str, _Array]
_Layers = dict[str, _Array]


class PaperTcnNetwork(PaperNetwork):
    """Temporal convolutional network of the paper; `PaperTcn` describes the computation.

    As in `PaperTcn`, only the steps that the last step depends on are computed. That is exact: layer norm
    treats each step by itself, and dropout drops a channel at all steps.
    """

    def __init__(self, mean: Reals, std: Reals, dropout: float) -> None:
        super().__init__(mean, std)
        layers = range(2 * _BLOCKS)
        self.convolutions = nn.ModuleList(
            nn.Conv2d(_FILTERS if i else BAROMETERS, _FILTERS, (1, _TAPS), stride=(1, 1 + i % 2))
            for i in layers
        )
        self.norms = nn.ModuleList(nn.LayerNorm(_FILTERS, _EPSILON) for _ in layers)
        self.match = nn.Linear(BAROMETERS, _FILTERS)
        self.dense = nn.ModuleList(nn.Linear(inputs, _UNITS) for inputs in (_FILTERS, _UNITS))
        self.dense_norms = nn.ModuleList(nn.LayerNorm(_UNITS, _EPSILON) for _ in range(2))
        self.out = nn.Linear(_UNITS, 2)
        self.drop_channels, self.drop = nn.Dropout1d(dropout), nn.Dropout(dropout)

    def logits(self, inputs: Tensor) -> Tensor:
        """Return the logits (n, 2) of standardised counts (n, 100, 6)."""
        values = inputs
        for block in range(_BLOCKS):
            residual = values[:, 1 - values.shape[1] % 2 :: 2]  # every second step, counted from the last
            if block == 0:
                residual = self.match(residual)
            for layer in (2 * block, 2 * block + 1):
                values = functional.selu(self.norms[layer](self._convolve(layer, values)))
                values = self.drop_channels(values.transpose(1, 2)).transpose(1, 2)  # (n, steps, 12)
            values = functional.selu(residual + values)
        values = values[:, -1]  # (n, 12)
        for dense, norm in zip(self.dense, self.dense_norms, strict=True):
            values = self.drop(functional.selu(norm(dense(values))))  # (n, 24)
        logits: Tensor = self.out(values)
        return logits

    def _convolve(self, layer: int, values: Tensor) -> Tensor:
        """Map (n, steps, channels) to (n, steps / stride, 12), counted from the last step; zeros before."""
        first = (values.shape[1] - 1) % (1 + layer % 2)
        padded = functional.pad(values, (0, 0, _TAPS - 1 - first, 0))
        image = padded[:, None].permute(0, 3, 1, 2)  # (n, channels, 1, steps); in memory channels are last
        outputs: Tensor = self.convolutions[layer](image)
        return outputs.permute(0, 2, 3, 1)[:, 0]

    def layers(self, state: _State) -> _Layers:
        """Return the layers of `PaperTcn`."""
        found = _linear("block0/match", state["match.weight"].T[None], state["match.bias"])
        for layer in range(2 * _BLOCKS):
            block, conv = divmod(layer, 2)
            kernel = state[f"convolutions.{layer}.weight"][:, :, 0].transpose(2, 1, 0)  # (taps, in, out)
            found |= _linear(f"block{block}/conv{conv}", kernel, state[f"convolutions.{layer}.bias"])
            found |= _layer_norm(f"block{block}/ln{conv}", state, f"norms.{layer}")
        for layer in range(2):
            found |= _linear(f"dense{layer}", state[f"dense.{layer}.weight"].T, state[f"dense.{layer}.bias"])
            found |= _layer_norm(f"dense{layer}_ln", state, f"dense_norms.{layer}")
        return found | _linear("out", state["out.weight"].T, state["out.bias"])


class FrequencyCnnNetwork(PaperNetwork):
    """Frequency CNN as the authors ran it; `InterleavedFrequencyCnn` describes the computation."""

    parts: Tensor  # (100, 102) of the DFT

    def __init__(self, mean: Reals, std: Reals, dropout: float) -> None:
        super().__init__(mean, std)
        self.register_buffer("parts", torch.as_tensor(PARTS.astype(np.float32)), persistent=False)
        self.convolutions = nn.ModuleList([nn.Conv2d(BINS, 50, 3, padding=1), nn.Conv2d(50, 20, 2)])
        self.norms = nn.ModuleList(nn.BatchNorm2d(size, _EPSILON, _MOMENTUM) for size in (50, 20))
        self.dense = nn.ModuleList([nn.Linear(40, 40), nn.Linear(40, 20)])
        self.dense_norms = nn.ModuleList(nn.BatchNorm1d(size, _EPSILON, _MOMENTUM) for size in (40, 20))
        self.out = nn.Linear(20, 2)
        self.drop_channels, self.drop = nn.Dropout2d(dropout), nn.Dropout(dropout)

    def logits(self, inputs: Tensor) -> Tensor:
        """Return the logits (n, 2) of standardised counts (n, 100, 6)."""
        count, length, cells = inputs.shape
        parts = inputs.reshape(count, cells, length) @ self.parts  # (n, 6, 102) real, then imaginary
        image = torch.hypot(parts[..., :BINS], parts[..., BINS:])[:, list(PIXELS)]  # (n, 6, 51)
        values = self.drop(image).view(count, 2, 3, BINS).permute(0, 3, 1, 2)  # (n, 51, 2, 3)
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            values = self.drop_channels(norm(functional.relu(convolution(values))))
        values = values.permute(0, 2, 3, 1).flatten(1)  # (n, 40), channels of one pixel, then of the other
        for dense, norm in zip(self.dense, self.dense_norms, strict=True):
            values = self.drop(functional.relu(norm(dense(values))))  # (n, 40), (n, 20)
        logits: Tensor = self.out(values)
        return logits

    def layers(self, state: _State) -> _Layers:
        """Return the layers of `FrequencyCnn`.

        Batch norm after ReLU is folded into the next layer, which has no padding; other batch norm into its
        own layer.
        """
        found: _Layers = {}
        factor, offset = np.ones(BINS), np.zeros(BINS)  # of the norm before a layer
        for layer in range(2):
            kernel = state[f"convolutions.{layer}.weight"].transpose(2, 3, 1, 0)  # (rows, columns, in, out)
            bias = state[f"convolutions.{layer}.bias"] + (kernel * offset[:, None]).sum(axis=(0, 1, 2))
            found |= _linear(f"conv{layer}", kernel * factor[:, None], bias)
            factor, offset = _batch_norm(state, f"norms.{layer}")
        factor, offset = np.tile(factor, 2), np.tile(offset, 2)  # for both pixels of the second convolution
        for layer in range(2):
            kernel = state[f"dense.{layer}.weight"].T  # (in, out)
            bias = state[f"dense.{layer}.bias"] + offset @ kernel
            after, added = _batch_norm(state, f"dense_norms.{layer}")
            found |= _linear(f"dense{layer}", kernel * factor[:, None] * after, bias * after + added)
            factor, offset = np.ones(len(bias)), np.zeros(len(bias))
        return found | _linear("out", state["out.weight"].T, state["out.bias"])


def _linear(name: str, kernel: _Array, bias: _Array) -> _Layers:
    return {f"{name}/kernel": kernel, f"{name}/bias": bias}


def _layer_norm(name: str, state: _State, norm: str) -> _Layers:
    return {f"{name}/gamma": state[f"{norm}.weight"], f"{name}/beta": state[f"{norm}.bias"]}


def _batch_norm(state: _State, norm: str) -> tuple[_Array, _Array]:
    """Return the factor and the offset of batch norm in evaluation; (channels,) each."""
    factor = state[f"{norm}.weight"] / np.sqrt(state[f"{norm}.running_var"] + _EPSILON)
    return factor, state[f"{norm}.bias"] - state[f"{norm}.running_mean"] * factor

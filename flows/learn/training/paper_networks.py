"""Networks of the paper in PyTorch, for training; the numpy detectors run the exported weights."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Final, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from operators.batch import BAROMETERS, Reals
from operators.detectors.frequency_cnn import BINS, PARTS, PIXELS

Arrays: TypeAlias = dict[str, NDArray[Any]]

_TAPS: Final = 8
_FILTERS: Final = 12
_UNITS: Final = 24
_BLOCKS: Final = 4
_EPSILON: Final = 1e-3  # of both norms; this and the next are Keras defaults
_MOMENTUM: Final = 0.01  # weight of a batch in the running mean and variance
_TRUNCATED: Final = 0.87962566103423978  # standard deviation of a unit normal that is cut off at 2


class Network(nn.Module):
    """Base class of the networks: standardised counts to logits of static and slip.

    Args:
        mean: (6,) mean of the training counts.
        std: (6,) standard deviation of the training counts.
    """

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

    @abstractmethod
    def arrays(self) -> Arrays:
        """Return the arrays that the detector of this network takes; float32."""


class PaperTcnNetwork(Network):
    """Temporal convolutional network of the paper; `PaperTcn` describes the computation.

    As in `PaperTcn`, only the steps that the last step depends on are computed. That is exact: layer norm
    treats each step by itself, and dropout drops a channel at all steps.

    Args:
        mean: (6,) of the counts in training
        std: (6,) of the counts in training
        dropout: Probability that a channel or a dense unit is dropped
        generator: Source of the initial weights and of the dropout
    """

    def __init__(self, mean: Reals, std: Reals, *, dropout: float, generator: torch.Generator) -> None:
        super().__init__(mean, std)
        layers = range(2 * _BLOCKS)
        self.convolutions = nn.ModuleList(_Causal(_FILTERS if i else BAROMETERS, 1 + i % 2) for i in layers)
        self.norms = nn.ModuleList(nn.LayerNorm(_FILTERS, _EPSILON) for _ in layers)
        self.match = nn.Linear(BAROMETERS, _FILTERS)
        self.dense = nn.ModuleList(nn.Linear(inputs, _UNITS) for inputs in (_FILTERS, _UNITS))
        self.dense_norms = nn.ModuleList(nn.LayerNorm(_UNITS, _EPSILON) for _ in range(2))
        self.out = nn.Linear(_UNITS, 2)
        self.drop_channels = _Dropout(dropout, generator, shared=(1,))
        self.drop = _Dropout(dropout, generator)
        _initialise(self, generator)

    def logits(self, inputs: Tensor) -> Tensor:
        """Return the logits (n, 2) of standardised counts (n, 100, 6)."""
        values = inputs
        for block in range(_BLOCKS):
            residual = values[:, 1 - values.shape[1] % 2 :: 2]  # every second step, counted from the last
            if block == 0:
                residual = self.match(residual)
            for layer in (2 * block, 2 * block + 1):
                normed = self.norms[layer](self.convolutions[layer](values))
                values = self.drop_channels(functional.selu(normed))  # (n, steps, 12)
            values = functional.selu(residual + values)
        values = values[:, -1]  # (n, 12)
        for dense, norm in zip(self.dense, self.dense_norms, strict=True):
            values = self.drop(functional.selu(norm(dense(values))))  # (n, 24)
        logits: Tensor = self.out(values)
        return logits

    def arrays(self) -> Arrays:
        """Return the arrays that `PaperTcn` takes."""
        state = _state(self)
        result: Arrays = {"mean": state["mean"], "std": state["std"]}
        for layer in range(2 * _BLOCKS):
            block, conv = divmod(layer, 2)
            kernel = state[f"convolutions.{layer}.taps.weight"][:, :, 0].transpose(2, 1, 0)  # (taps, in, out)
            result |= _linear(f"block{block}/conv{conv}", kernel, state[f"convolutions.{layer}.taps.bias"])
            result |= _layer_norm(f"block{block}/ln{conv}", state, f"norms.{layer}")
        result |= _linear("block0/match", state["match.weight"].T[None], state["match.bias"])
        for layer in range(2):
            kernel = state[f"dense.{layer}.weight"].T
            result |= _linear(f"dense{layer}", kernel, state[f"dense.{layer}.bias"])
            result |= _layer_norm(f"dense{layer}_ln", state, f"dense_norms.{layer}")
        return _single(result | _linear("out", state["out.weight"].T, state["out.bias"]))


class FrequencyCnnNetwork(Network):
    """Frequency CNN of the paper; `FrequencyCnn` describes the computation.

    Args:
        mean: (6,) of the counts in training
        std: (6,) of the counts in training
        interleaved: True for the image of `InterleavedFrequencyCnn`
        dropout: Probability that a bin of the image, a channel or a dense unit is dropped
        generator: Source of the initial weights and of the dropout
    """

    parts: Tensor  # (100, 102) of the DFT

    def __init__(
        self, mean: Reals, std: Reals, *, interleaved: bool, dropout: float, generator: torch.Generator
    ) -> None:
        super().__init__(mean, std)
        self.interleaved = interleaved
        self.register_buffer("parts", torch.as_tensor(PARTS.astype(np.float32)), persistent=False)
        self.convolutions = nn.ModuleList([nn.Conv2d(BINS, 50, 3, padding=1), nn.Conv2d(50, 20, 2)])
        self.norms = nn.ModuleList(nn.BatchNorm2d(size, _EPSILON, _MOMENTUM) for size in (50, 20))
        self.dense = nn.ModuleList([nn.Linear(40, 40), nn.Linear(40, 20)])
        self.dense_norms = nn.ModuleList(nn.BatchNorm1d(size, _EPSILON, _MOMENTUM) for size in (40, 20))
        self.out = nn.Linear(20, 2)
        self.drop_channels = _Dropout(dropout, generator, shared=(2, 3))
        self.drop = _Dropout(dropout, generator)
        _initialise(self, generator)

    def logits(self, inputs: Tensor) -> Tensor:
        """Return the logits (n, 2) of standardised counts (n, 100, 6)."""
        count, length, cells = inputs.shape
        rows = inputs.reshape(count, cells, length) if self.interleaved else inputs.transpose(1, 2)
        parts = rows @ self.parts  # (n, 6, 102) real, then imaginary
        image = torch.hypot(parts[..., :BINS], parts[..., BINS:])[:, list(PIXELS)]  # (n, 6, 51)
        values = self.drop(image).view(count, 2, 3, BINS).permute(0, 3, 1, 2)  # (n, 51, 2, 3)
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            values = self.drop_channels(norm(functional.relu(convolution(values))))
        values = values.permute(0, 2, 3, 1).flatten(1)  # (n, 40), channels of one pixel, then of the other
        for dense, norm in zip(self.dense, self.dense_norms, strict=True):
            values = self.drop(functional.relu(norm(dense(values))))  # (n, 40), (n, 20)
        logits: Tensor = self.out(values)
        return logits

    def arrays(self) -> Arrays:
        """Return the arrays that `FrequencyCnn` takes.

        Batch norm after ReLU is folded into the next layer, which has no padding; other batch norm into its
        own layer.
        """
        state = _state(self)
        result: Arrays = {"mean": state["mean"], "std": state["std"]}
        factor, offset = np.ones(BINS), np.zeros(BINS)  # of the norm before a layer
        for layer in range(2):
            kernel = state[f"convolutions.{layer}.weight"].transpose(2, 3, 1, 0)  # (rows, columns, in, out)
            bias = state[f"convolutions.{layer}.bias"] + (kernel * offset[:, None]).sum(axis=(0, 1, 2))
            result |= _linear(f"conv{layer}", kernel * factor[:, None], bias)
            factor, offset = _batch_norm(state, f"norms.{layer}")
        factor, offset = np.tile(factor, 2), np.tile(offset, 2)  # for both pixels of the second convolution
        for layer in range(2):
            kernel = state[f"dense.{layer}.weight"].T  # (in, out)
            bias = state[f"dense.{layer}.bias"] + offset @ kernel
            after, added = _batch_norm(state, f"dense_norms.{layer}")
            result |= _linear(f"dense{layer}", kernel * factor[:, None] * after, bias * after + added)
            factor, offset = np.ones(len(bias)), np.zeros(len(bias))
        return _single(result | _linear("out", state["out.weight"].T, state["out.bias"]))


class _Causal(nn.Module):
    """Causal, zero-padded convolution in time at every `stride`-th step, counted from the last.

    Args:
        channels: Channels of the input
        stride: 1 or 2
    """

    def __init__(self, channels: int, stride: int) -> None:
        super().__init__()
        self.stride = stride
        self.taps = nn.Conv2d(channels, _FILTERS, (1, _TAPS), stride=(1, stride))

    def forward(self, values: Tensor) -> Tensor:
        """Map (n, steps, channels) to (n, steps / stride, 12)."""
        first = (values.shape[1] - 1) % self.stride
        padded = functional.pad(values, (0, 0, _TAPS - 1 - first, 0))
        image = padded[:, None].permute(0, 3, 1, 2)  # (n, channels, 1, steps); in memory channels are last
        outputs: Tensor = self.taps(image)
        return outputs.permute(0, 2, 3, 1)[:, 0]


class _Dropout(nn.Module):
    """Dropout with its own generator, so that training is reproducible.

    Args:
        rate: Probability of being dropped.
        generator: Source of the random numbers.
        shared: Axes along which all values are dropped together.
    """

    def __init__(self, rate: float, generator: torch.Generator, shared: tuple[int, ...] = ()) -> None:
        super().__init__()
        self.kept, self.generator, self.shared = 1 - rate, generator, shared

    def forward(self, values: Tensor) -> Tensor:
        """Return values of any shape with dropout; in evaluation, unchanged."""
        if not self.training or self.kept == 1:
            return values
        shape = [1 if axis in self.shared else size for axis, size in enumerate(values.shape)]
        mask = torch.empty(shape, device=values.device).bernoulli_(self.kept, generator=self.generator)
        return values * mask.div_(self.kept)


def _initialise(network: nn.Module, generator: torch.Generator) -> None:
    """Set He normal kernels as Keras draws them (cut off at two standard deviations), and zero biases."""
    for name, values in network.named_parameters():
        if values.ndim > 1:
            deviation = (2 / values[0].numel()) ** 0.5 / _TRUNCATED
            nn.init.trunc_normal_(values, 0, deviation, -2 * deviation, 2 * deviation, generator)
        elif name.endswith("bias"):
            nn.init.zeros_(values)


def _state(network: nn.Module) -> Mapping[str, NDArray[np.float64]]:
    state: dict[str, Tensor] = network.state_dict()
    return {name: values.cpu().numpy().astype(np.float64) for name, values in state.items()}


def _linear(name: str, kernel: NDArray[np.float64], bias: NDArray[np.float64]) -> Arrays:
    return {f"{name}/kernel": kernel, f"{name}/bias": bias}


def _layer_norm(name: str, state: Mapping[str, NDArray[np.float64]], norm: str) -> Arrays:
    return {f"{name}/gamma": state[f"{norm}.weight"], f"{name}/beta": state[f"{norm}.bias"]}


def _batch_norm(
    state: Mapping[str, NDArray[np.float64]], norm: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the factor and the offset of batch norm in evaluation; (channels,) each."""
    factor = state[f"{norm}.weight"] / np.sqrt(state[f"{norm}.running_var"] + _EPSILON)
    return factor, state[f"{norm}.bias"] - state[f"{norm}.running_mean"] * factor


def _single(arrays: Arrays) -> Arrays:
    return {name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()}

"""The paper's networks in PyTorch, and their training on windows; the numpy detectors run the weights."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional, utils

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import PAPER_TOUCH, PaperRecipe
from flows.learn.training.trained_model import Arrays, Progress
from flows.learn.training.training_loop import (
    Crops,
    Network,
    Trained,
    TrainingTask,
    augmented,
    fit,
    set_seed,
    training_device,
)
from operators.batch import BAROMETERS, SLIP, UNKNOWN, Flags, Reals
from operators.detectors.frequency_cnn import BINS, PARTS, PIXELS
from operators.errors import InputError

LENGTH: Final = PaperRecipe.receptive_field  # samples of a window
_BLOCK: Final = 1024  # windows evaluated at once
_ADAM_EPSILON: Final = 1e-7  # Keras's
_TAPS: Final = 8
_FILTERS: Final = 12
_UNITS: Final = 24
_BLOCKS: Final = 4
_EPSILON: Final = 1e-3  # of both norms; this and the next are Keras defaults
_MOMENTUM: Final = 0.01  # weight of a batch in the running mean and variance
_TRUNCATED: Final = 0.87962566103423978  # standard deviation of a unit normal that is cut off at 2


def train_windowed(
    train: Sequence[LabelledRecording],
    validation: Sequence[LabelledRecording],
    recipe: PaperRecipe,
    progress: Progress = lambda _done, _all, _check: None,
) -> Trained:
    """Train one of the paper's networks by the paper's recipe, with a check after each epoch.

    Args:
        train: Recordings of the train split; their counts also determine the standardisation.
        validation: Recordings that choose the epoch.
        recipe: Network, and settings of its training.
        progress: Called after each step.

    Raises:
        InputError: if the recordings of a split have no slip or no static samples.
    """
    return fit(_WindowedTask(train, validation, recipe), progress)


class Windows:
    """Windows that end at the evaluated samples of recordings with a known label.

    Raises:
        InputError: if there is no window of slip, or none of static.
    """

    def __init__(self, recordings: Sequence[LabelledRecording], device: torch.device) -> None:
        self._crops = Crops(recordings, LENGTH, device)
        label = self._crops.label[self._crops.first + LENGTH - 1]
        self._first = self._crops.first[label != UNKNOWN]
        self.slip: Flags = label[label != UNKNOWN] == SLIP  # (n,) label at the newest sample
        if not 0 < self.slip.sum() < len(self.slip):
            raise InputError("the train or validation split", "must have windows of slip and of static")

    def __len__(self) -> int:
        return len(self.slip)

    def take(self, picked: NDArray[np.intp]) -> Tensor:
        """Return the counts of some windows (k,), newest last; (k, 100, 6) float32."""
        first = torch.as_tensor(self._first[picked]).to(self._crops.counts.device)
        return self._crops.counts[self._crops.rows(first)].float()

    def balanced(self, rng: np.random.Generator) -> NDArray[np.intp]:
        """Return as many windows of slip as of static, shuffled; the larger class is sampled."""
        slip, static = np.flatnonzero(self.slip), np.flatnonzero(~self.slip)
        fewer = min(len(slip), len(static))
        picked = np.concatenate([rng.permutation(slip)[:fewer], rng.permutation(static)[:fewer]])
        return rng.permutation(picked)


class _WindowedTask(TrainingTask):
    """Training of a network of the paper on windows."""

    def __init__(
        self, train: Sequence[LabelledRecording], validation: Sequence[LabelledRecording], recipe: PaperRecipe
    ) -> None:
        self._recipe, self._device = recipe, training_device()
        self._windows, self._unseen = Windows(train, self._device), Windows(validation, self._device)
        self._rng = np.random.default_rng(recipe.seed)
        self._generator = torch.Generator(self._device).manual_seed(recipe.seed)
        self._picked = np.empty(0, np.intp)  # windows of the epoch
        slip = int(self._windows.slip.sum())
        balanced = 2 * min(slip, len(self._windows) - slip)
        self.check_every = max(balanced // recipe.batch, 1)  # an incomplete batch is left out
        self.steps = recipe.epochs * self.check_every
        counts = np.concatenate([each.counts for each in train if len(each) >= LENGTH]).astype(np.float64)
        mean, std = counts.mean(axis=0), np.maximum(counts.std(axis=0), 1)
        self.network = paper_network(mean, std, recipe).to(self._device)
        self.optimiser = torch.optim.Adam(
            self.network.parameters(), recipe.rate, eps=_ADAM_EPSILON, foreach=True
        )

    def loss(self, step: int) -> Tensor:
        recipe, number = self._recipe, (step - 1) % self.check_every
        if number == 0:
            self._picked = self._windows.balanced(self._rng)
        picked = self._picked[number * recipe.batch : (number + 1) * recipe.batch]
        counts = augmented(self._windows.take(picked).transpose(1, 2), PAPER_TOUCH, self._generator)
        slip = torch.as_tensor(self._windows.slip[picked].astype(np.int64)).to(self._device)
        return functional.cross_entropy(self.network(counts.transpose(1, 2)), slip)

    def clip(self) -> None:
        """Limit the norm of the gradient of each array by itself, as Keras does."""
        for parameter in self.network.parameters():
            utils.clip_grad_norm_(parameter, self._recipe.clip)

    def predict(self) -> tuple[Flags, Flags]:
        blocks = np.split(np.arange(len(self._unseen)), range(_BLOCK, len(self._unseen), _BLOCK))
        predicted = torch.cat([self.network(self._unseen.take(block)).argmax(1) for block in blocks])
        return predicted.cpu().numpy() == 1, self._unseen.slip


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
    """Frequency CNN of the paper; `FrequencyCnn` describes the computation."""

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

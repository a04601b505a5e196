"""Dense training of the TCN: whole sequences, one label per sample.

Windowed training computes a window of 100 samples for each label. Here neighbouring samples share the
computation, which is 60 to 90 times less per epoch. Each crop is drawn from any dataset with the same
probability, and any place in it. Its first samples, which have no full window, and those without a label are
masked; all others have the same weight, so that the probability is that of slip in such data.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional, utils

from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from flows.learn.training.recipe import Recipe
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
from flows.run.executor import one_thread
from operators.batch import BAROMETERS, SLIP, STATIC, UNKNOWN, Flags, ms
from operators.detectors import Tcn
from operators.errors import InputError, ParameterError

_HEAD: Final = 500 * ms  # ns, of the beginning of a recording
_CLIP: Final = 1.0  # maximum norm of the gradient
_LAST_RATE: Final = 0.01  # learning rate relative to its peak, at the end of the cosine


def train_dense(
    train: Sequence[LabelledRecording],
    validation: Sequence[LabelledRecording],
    recipe: Recipe,
    progress: Progress = lambda _done, _all, _check: None,
    start: Tcn | None = None,
) -> Trained:
    """Train a TCN, on a GPU if there is one, else in one thread.

    On busy cores, waiting for other threads takes longer than the work; and the result does not depend on the
    number of cores.

    Args:
        train: Recordings of the train split.
        validation: Recordings that choose the best check and the end of training.
        recipe: Size of the network and course of the training.
        progress: Called after each step.
        start: Network to start from, of the same size; its batch norms stay folded. None: random weights.

    Raises:
        InputError: if the training recordings lack a class.
        ParameterError: if no recording to validate on has a label.
    """
    with one_thread():
        return fit(_DenseTask(train, validation, recipe, start), progress)


class _DenseTask(TrainingTask):
    """Dense training of a TCN."""

    def __init__(
        self,
        train: Sequence[LabelledRecording],
        validation: Sequence[LabelledRecording],
        recipe: Recipe,
        start: Tcn | None,
    ) -> None:
        self.steps, self.check_every = recipe.steps, max(recipe.steps // recipe.checks, 1)
        self._recipe, self._device = recipe, training_device()
        self._warm_up = max(WARM_UP, recipe.receptive_field - 1)  # samples
        train = [with_past(each, max(self._warm_up, recipe.crop - len(each))) for each in train if len(each)]
        validation = [with_past(each, self._warm_up) for each in validation if len(each)]
        self._crops = Crops(train, recipe.crop, self._device)
        label = self._crops.label
        slip, static = int((label == SLIP).sum()), int((label == STATIC).sum())
        if not slip or not static:
            reason = f"{slip:,} samples of slip and {static:,} of static to learn from: both are needed"
            raise InputError("train", reason)
        unseen = [np.empty(0, label.dtype), *(recording.label[self._warm_up :] for recording in validation)]
        self._unseen_label = np.concatenate(unseen)
        if (self._unseen_label == UNKNOWN).all():
            raise ParameterError(
                "train_dense", "validation", f"{len(validation)} without labels", "recordings with labels"
            )
        self._known = torch.as_tensor(label != UNKNOWN).to(self._device, torch.float32)  # (n,)
        self._slip = torch.as_tensor(label == SLIP).to(self._device, torch.float32)  # (n,)
        self._first = torch.as_tensor(self._crops.first).to(self._device)
        self._unseen = [  # (1, cells, n) each
            torch.as_tensor(recording.counts.astype(np.float32)).to(self._device).T[None]
            for recording in validation
        ]
        set_seed(recipe.seed)
        self._generator = torch.Generator(self._device).manual_seed(recipe.seed)
        self._fingertip = train[0].fingertip
        cells = self._crops.counts.shape[1]
        self.network = DenseTcn(recipe, cells, start).to(self._device)
        learned = [each for each in self.network.parameters() if each.requires_grad]
        self.optimiser = torch.optim.AdamW(learned, recipe.rate, weight_decay=recipe.decay)

    def loss(self, step: int) -> Tensor:
        """Return the weighted loss of random crops."""
        recipe, generator = self._recipe, self._generator
        for group in self.optimiser.param_groups:
            group["lr"] = recipe.rate * _relative_rate(step, recipe)
        first = self._first[self._crops.draw(recipe.batch, generator)]
        rows, counts = self._crops.stretched(first, recipe.augmentation, generator)  # (b, n), (b, n, cells)
        counts = augmented(counts.transpose(1, 2), recipe.augmentation, generator, self._fingertip)
        logit = self.network(counts)[:, self._warm_up :]
        evaluated = rows[:, self._warm_up :]
        known, slip = self._known[evaluated], self._slip[evaluated]
        each = functional.binary_cross_entropy_with_logits(logit, slip, reduction="none")
        loss: Tensor = (each * known).sum() / known.sum().clamp(min=1)
        return loss

    def clip(self) -> None:
        utils.clip_grad_norm_(self.network.parameters(), _CLIP)

    def predict(self) -> tuple[Flags, Flags]:
        logits = [self.network(counts)[0, self._warm_up :].cpu().numpy() for counts in self._unseen]
        known = self._unseen_label != UNKNOWN
        return np.concatenate(logits)[known] > 0, self._unseen_label[known] == SLIP


def with_past(recording: LabelledRecording, samples: int) -> LabelledRecording:
    """Return a recording with samples before its first one, so that a network also learns the beginning.

    A grasp closes within the first two seconds. The samples have no label: they are the first half second,
    back and forth, so that nothing jumps.

    >>> recording = LabelledRecording(np.arange(4, dtype=np.int16)[:, None], np.zeros(4, np.int8))
    >>> with_past(recording, 3).counts.ravel().tolist()
    [2, 1, 0, 0, 1, 2, 3]
    """
    head = recording.counts[: recording.sampling.samples(_HEAD)]
    past = np.pad(head, ((samples, 0), (0, 0)), "symmetric")[:samples]
    return replace(
        recording,
        counts=np.concatenate([past, recording.counts]),
        label=np.concatenate([np.full(samples, UNKNOWN, np.int8), recording.label]),
        valid=None,
        sliding=None,
        strokes=None,
    )


def _relative_rate(step: int, recipe: Recipe) -> float:
    """Return the learning rate relative to its peak: a linear warm-up from step 1, then a cosine."""
    warm = max(round(recipe.warm_up * recipe.steps), 1)
    if step <= warm:
        return step / warm
    passed = (step - warm) / max(recipe.steps - warm, 1)
    return _LAST_RATE + (1 - _LAST_RATE) * (1 + math.cos(math.pi * min(passed, 1.0))) / 2


class DenseTcn(Network):
    """Network that computes the logit of slip at every sample of a sequence.

    Features of a sample are asinh(x / position_scale) and asinh(dx / step_scale) of each barometer, dx the
    step from the previous sample: the signal matters from one count (noise) to 500 (saturation). Blocks
    of two causal convolutions with batch norm and ReLU, and an identity skip if the widths agree; then dense
    layers. Batch norm is folded into the exported weights.

    Args:
        recipe: Size of the network.
        cells: Number of cells.
        start: Detector of this size to start from; its weights contain its batch norms. None: random weights.
    """

    def __init__(self, recipe: Recipe, cells: int = BAROMETERS, start: Tcn | None = None) -> None:
        super().__init__()
        self.recipe, folded = recipe, start is not None
        convs: list[_Layer] = []
        width = 2 * cells
        for dilation in recipe.dilations:
            for _ in range(2):
                convs.append(_Layer(width, recipe.filters, recipe.taps, dilation, folded=folded))
                width = recipe.filters
        dense = [_Layer(inputs, recipe.units, folded=folded) for inputs in (width, recipe.units)]
        self._convs, self._dense = tuple(convs), tuple(dense)  # typed
        self.convs, self.dense = nn.ModuleList(convs), nn.ModuleList(dense)  # registered with torch
        self.out = nn.Conv2d(recipe.units, 1, 1)
        if start is not None:
            targets = [*(layer.conv for layer in (*convs, *dense)), self.out]
            for target, layer in zip(targets, start.layers, strict=True):
                target.weight.data = torch.as_tensor(layer.kernel.transpose(2, 1, 0)[:, :, None].copy())
                target.bias = nn.Parameter(torch.as_tensor(layer.bias.copy()))

    def forward(self, counts: Tensor) -> Tensor:
        """Return the logit of slip (b, n) of counts (b, cells, n); the first ones depend on the padding."""
        steps = torch.diff(counts, dim=2, prepend=counts[..., :1])
        scale = self.recipe
        x = torch.cat([torch.asinh(counts / scale.position_scale), torch.asinh(steps / scale.step_scale)], 1)
        x = x[:, :, None].contiguous(memory_format=torch.channels_last)  # (b, 2 cells, 1, n)
        for first, second in zip(self._convs[::2], self._convs[1::2], strict=True):
            y = functional.dropout2d(second(first(x)), self.recipe.dropout, self.training)
            x = y + x if first.conv.in_channels == second.conv.out_channels else y  # (b, filters, 1, n)
        for layer in self._dense:
            x = layer(x)
        logit: Tensor = self.out(x)[:, 0, 0]
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
        arrays["out/kernel"] = _array(self.out.weight[:, :, 0, 0].T)
        arrays["out/bias"] = _array(self.out.bias)
        return arrays


class _Layer(nn.Module):
    """Causal convolution over the last axis, batch norm unless it is folded, and ReLU.

    Its input has four axes, because torch stores channels last for convolutions over two axes only: a third
    less time on a CPU.
    """

    def __init__(self, inputs: int, outputs: int, taps: int = 1, dilation: int = 1, *, folded: bool) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, (1, taps), dilation=(1, dilation))
        self.norm = None if folded else nn.BatchNorm2d(outputs)
        self.past = (taps - 1) * dilation

    def forward(self, x: Tensor) -> Tensor:
        """Map (b, inputs, 1, n) to (b, outputs, 1, n), with zeros before the first step."""
        y: Tensor = self.conv(functional.pad(x, (self.past, 0)))
        return functional.relu(y if self.norm is None else self.norm(y))

    def folded(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return kernel (taps, inputs, outputs) and bias (outputs,) with the running statistics folded in."""
        norm = self.norm
        if norm is None:
            return _array(self.conv.weight[:, :, 0].permute(2, 1, 0)), _array(self.conv.bias)
        assert norm.running_mean is not None
        assert norm.running_var is not None
        scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)  # (outputs,)
        kernel = self.conv.weight[:, :, 0] * scale[:, None, None]  # (outputs, inputs, taps)
        bias = self.conv.bias
        assert bias is not None
        return _array(kernel.permute(2, 1, 0)), _array((bias - norm.running_mean) * scale + norm.bias)


def _array(tensor: Tensor | None) -> NDArray[Any]:
    assert tensor is not None
    return np.array(tensor.detach().cpu().numpy(), np.float32, order="C")  # a copy: training goes on

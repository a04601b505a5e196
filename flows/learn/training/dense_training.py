"""Dense training of the TCN: whole sequences, one label per sample.

Windowed training computes a window of 100 samples for each label. Here neighbouring samples share the
computation, which is 60 to 90 times less per epoch. Crops are drawn from all recordings. Their warm-up
samples and those without a label are masked. Slip and static have the same total weight.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional, utils

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.sampling import WARM_UP
from flows.learn.training.augmentation import augmented
from flows.learn.training.recipe import Recipe
from flows.learn.training.tcn_module import DenseTcn
from flows.learn.training.trained_model import Progress
from flows.learn.training.training_loop import Crops, Trained, TrainingTask, fit, set_seed, training_device
from flows.run.executor import one_thread
from operators.batch import SLIP, STATIC, UNKNOWN, Flags
from operators.detectors import Tcn
from operators.errors import ParameterError

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
        ParameterError: if the training recordings are too short or lack a class, or no recording to validate
            on has a label after the warm-up.
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
        self.patience = recipe.patience
        self._recipe, self._device = recipe, training_device()
        self._warm_up = max(WARM_UP, recipe.receptive_field - 1)  # samples
        self._crops = Crops(train, recipe.crop, self._device)
        label = self._crops.label
        slip, static = int((label == SLIP).sum()), int((label == STATIC).sum())
        if not slip or not static:
            reason = f"recordings of {recipe.crop} samples or more, with slip and static among them"
            longest = max(map(len, train), default=0)
            given = f"up to {longest} samples each, {slip} slip and {static} static in those long enough"
            raise ParameterError("train_dense", "train", given, reason)
        unseen = [np.empty(0, label.dtype), *(recording.label[self._warm_up :] for recording in validation)]
        self._unseen_label = np.concatenate(unseen)
        if (self._unseen_label == UNKNOWN).all():
            reason = f"recordings with labels after their first {self._warm_up} samples"
            raise ParameterError("train_dense", "validation", f"{len(validation)} without", reason)
        weight = np.select([label == SLIP, label == STATIC], [0.5 / slip, 0.5 / static]) * len(label)
        self._weight = torch.as_tensor(weight).to(self._device, torch.float32)  # (n,) 0: no label
        self._slip = torch.as_tensor(label == SLIP).to(self._device, torch.float32)  # (n,)
        self._first = torch.as_tensor(self._crops.first).to(self._device)
        self._unseen = [  # (1, cells, n) each
            torch.as_tensor(recording.counts).to(self._device, torch.float32).T[None]
            for recording in validation
        ]
        set_seed(recipe.seed)
        self._generator = torch.Generator(self._device).manual_seed(recipe.seed)
        self._fingertip = train[0].fingertip
        cells = self._crops.counts.shape[1]
        self.network = DenseTcn(recipe, cells) if start is None else DenseTcn.of_detector(start)
        self.network.to(self._device)
        learned = [each for each in self.network.parameters() if each.requires_grad]
        self.optimiser = torch.optim.AdamW(learned, recipe.rate, weight_decay=recipe.decay)

    def loss(self, step: int) -> Tensor:
        """Return the weighted loss of random crops."""
        recipe, generator = self._recipe, self._generator
        for group in self.optimiser.param_groups:
            group["lr"] = recipe.rate * _relative_rate(step, recipe)
        chosen = torch.randint(len(self._first), (recipe.batch,), generator=generator, device=self._device)
        rows = self._crops.rows(self._first[chosen])  # (b, n)
        counts = self._crops.counts[rows].to(torch.float32).transpose(1, 2)  # (b, cells, n)
        counts = augmented(counts, recipe.augmentation, generator, self._fingertip)
        logit = self.network(counts)[:, self._warm_up :]
        evaluated = rows[:, self._warm_up :]
        weight, slip = self._weight[evaluated], self._slip[evaluated]
        each = functional.binary_cross_entropy_with_logits(logit, slip, reduction="none")
        loss: Tensor = (each * weight).sum() / weight.sum().clamp(min=1)
        return loss

    def clip(self) -> None:
        utils.clip_grad_norm_(self.network.parameters(), _CLIP)

    def predict(self) -> tuple[Flags, Flags]:
        logits = [self.network(counts)[0, self._warm_up :].cpu().numpy() for counts in self._unseen]
        known = self._unseen_label != UNKNOWN
        return np.concatenate(logits)[known] > 0, self._unseen_label[known] == SLIP


def _relative_rate(step: int, recipe: Recipe) -> float:
    """Return the learning rate relative to its peak: a linear warm-up from step 1, then a cosine."""
    warm = max(round(recipe.warm_up * recipe.steps), 1)
    if step <= warm:
        return step / warm
    passed = (step - warm) / max(recipe.steps - warm, 1)
    return _LAST_RATE + (1 - _LAST_RATE) * (1 + math.cos(math.pi * min(passed, 1.0))) / 2

"""Training of all networks: crops, steps of an optimiser, and regular checks on the validation split."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.measures import accuracy, balanced, confusion
from flows.learn.training.trained_model import Arrays, Check, Progress
from operators.batch import Codes, Flags


class Crops:
    """Recordings joined on a device, and the crops of one length that lie within a recording.

    Args:
        recordings: Recordings; those shorter than a crop are left out.
        length: Samples of a crop.
        device: Device of the counts.
    """

    def __init__(self, recordings: Sequence[LabelledRecording], length: int, device: torch.device) -> None:
        usable = [recording for recording in recordings if len(recording) >= length]
        cells = usable[0].counts.shape[1] if usable else 0
        counts = np.concatenate([np.empty((0, cells), np.int16), *(recording.counts for recording in usable)])
        begins = np.cumsum([0, *(len(recording) for recording in usable)]).tolist()
        first: list[NDArray[np.int64]] = [
            np.arange(begin, end - length + 1) for begin, end in pairwise(begins)
        ]
        self.counts = torch.as_tensor(counts).to(device)  # (n, cells) int16
        self.label: Codes = np.concatenate([np.empty(0, np.int8), *(each.label for each in usable)])  # (n,)
        self.first = np.concatenate([np.empty(0, np.int64), *first])  # (m,) first row of each crop
        self._offsets = torch.arange(length, device=device)

    def rows(self, first: Tensor) -> Tensor:
        """Return the rows (k, length) of crops that begin at rows `first` (k,), on the device."""
        return first[:, None] + self._offsets


class Network(nn.Module):
    """Torch module whose weights a detector takes."""

    @abstractmethod
    def arrays(self) -> Arrays:
        """Return the weights."""


class TrainingTask(ABC):
    """Network to train, with its optimiser, loss and validation."""

    network: Network
    optimiser: torch.optim.Optimizer
    steps: int  # of the optimiser
    check_every: int  # steps
    patience: int | None = None  # checks without a better score before training ends; None: no limit

    @abstractmethod
    def loss(self, step: int) -> Tensor:
        """Return the loss of a batch, nats; the first step is 1."""

    @abstractmethod
    def clip(self) -> None:
        """Limit the gradient."""

    @abstractmethod
    def predict(self) -> tuple[Flags, Flags]:
        """Return the predicted and the labelled slip of the validation split; (n,) each."""


@dataclass(frozen=True, slots=True)
class Trained:
    """Trained network at its best check."""

    arrays: Arrays
    curve: tuple[Check, ...]


def training_device() -> torch.device:
    """Return the GPU if there is one, otherwise the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def set_seed(seed: int) -> None:
    """Seed torch's random numbers."""
    cast("Any", torch).manual_seed(seed)  # has no type annotations


def fit(task: TrainingTask, progress: Progress) -> Trained:
    """Train a network, and keep the weights with the best balanced accuracy on validation.

    Args:
        task: Network to train.
        progress: Called after each step.
    """
    began, curve, losses = perf_counter(), list[Check](), list[Tensor]()
    arrays: Arrays = {}
    for step in range(1, task.steps + 1):
        losses.append(_step(task, step))
        check = None
        if step % task.check_every == 0 or step == task.steps:
            scores, loss = _evaluate(task), float(np.mean([each.item() for each in losses]))
            check = Check(step, perf_counter() - began, loss, *scores)
            losses.clear()
            curve.append(check)
            if best(curve) is check:
                arrays = task.network.arrays()
        progress(step, task.steps, check)
        if check and task.patience and len(curve) - 1 - curve.index(best(curve)) >= task.patience:
            break
    return Trained(arrays, tuple(curve))


def _step(task: TrainingTask, step: int) -> Tensor:
    task.network.train()
    loss = task.loss(step)
    task.optimiser.zero_grad()
    torch.autograd.backward(loss)
    task.clip()
    task.optimiser.step()
    return loss.detach()


def _evaluate(task: TrainingTask) -> tuple[float, float]:
    """Return accuracy and balanced accuracy on the validation recordings, %."""
    task.network.eval()
    with torch.no_grad():
        counts = confusion(*task.predict())
    return float(accuracy(counts)), float(balanced(counts))


def best(curve: Sequence[Check]) -> Check:
    """Return the check with the best balanced accuracy, the first of equals."""
    return max(curve, key=lambda check: check.balanced)

"""Training of all networks: crops, augmentation, steps of an optimiser, checks on the validation split."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any, Final, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.measures import accuracy, balanced, confusion
from flows.learn.training.recipe import STRETCHED, Augmentation
from flows.learn.training.trained_model import Arrays, Check, Progress
from operators.batch import Codes, Flags
from operators.fingertip import TAKKTILE, Fingertip

_WAVES: Final = 3  # sines in a change of load
_SLOWEST: Final = 0.1  # Hz
_FASTEST: Final = 2.0  # Hz


class Crops:
    """Recordings joined on a device, and the crops of one length that lie within a recording.

    Args:
        recordings: Recordings; those shorter than a crop are left out.
        length: Samples of a crop.
        device: Device of the counts.
    """

    def __init__(self, recordings: Sequence[LabelledRecording], length: int, device: torch.device) -> None:
        usable = [recording for recording in recordings if len(recording) >= length]
        usable.sort(key=lambda recording: recording.dataset)  # stable
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
        varied = np.repeat([each.plan in STRETCHED for each in usable], [*map(len, usable)])
        self._varied = torch.as_tensor(varied).to(device) if varied.any() else None  # (n,)
        _, of_recording = np.unique([each.dataset for each in usable], return_inverse=True)
        crops = np.bincount(of_recording, weights=[*map(len, first)])  # of each dataset
        sizes = crops.astype(np.int64)
        self._sizes, self._starts = (torch.as_tensor(each) for each in (sizes, np.cumsum(sizes) - sizes))

    def draw(self, crops: int, generator: torch.Generator) -> Tensor:
        """Draw crops (k,), numbers of rows of `first`; all datasets are equally likely."""
        device = generator.device
        dataset = torch.randint(len(self._sizes), (crops,), generator=generator, device=device)
        share = torch.rand(crops, generator=generator, device=device, dtype=torch.float64)
        sizes, starts = self._sizes.to(device)[dataset], self._starts.to(device)[dataset]
        return starts + (share * sizes).long()

    def stretched(
        self, first: Tensor, how: Augmentation, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return rows (k, length) and counts (k, length, cells) of crops that begin at rows `first` (k,).

        The counts of a slower hand are interpolated between rows; its rows, for the labels, are the nearest.
        """
        if self._varied is None:
            rows = self.rows(first)
            return rows, self.counts[rows].float()
        share, chosen = (torch.rand(len(first), generator=generator, device=first.device) for _ in range(2))
        slower = (chosen < how.stretch) & self._varied[first]
        factor = torch.where(slower, torch.exp(share * math.log(how.slowest)), 1.0)[:, None]
        place, last = self._offsets[None].double() / factor.double(), self._offsets[-1]
        before = place.floor().long()
        weight = (place - before).float()[..., None]
        counts = [
            self.counts[first[:, None] + torch.minimum(each, last)].float() for each in (before, before + 1)
        ]
        return first[:, None] + place.round().long(), counts[0] * (1 - weight) + counts[1] * weight

    def rows(self, first: Tensor) -> Tensor:
        """Return the rows (k, length) of crops that begin at rows `first` (k,), on the device."""
        return first[:, None] + self._offsets


def augmented(
    counts: Tensor, how: Augmentation, generator: torch.Generator, fingertip: Fingertip = TAKKTILE
) -> Tensor:
    """Augment counts (b, cells, n) of a fingertip at random, each crop independently."""
    crops, cells, samples = counts.shape
    device = counts.device

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, device=device)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, device=device)

    def chosen(probability: float) -> Tensor:
        return (uniform(crops) < probability)[:, None, None]  # (b, 1, 1)

    flips = chosen(how.flip), chosen(how.flip)  # along x, along y
    x = torch.where(flips[0], counts[:, fingertip.mirrored()], counts)
    x = torch.where(flips[1], x[:, fingertip.mirrored(upside_down=True)], x)
    if how.gain:
        spread = how.gain_spread * (normal(crops, 1, 1) + 0.8 * normal(crops, cells, 1))
        x = x * torch.exp(chosen(how.gain) * spread)
    if how.load:
        time = torch.arange(samples, device=device) / fingertip.rate  # (n,) s
        frequency = _SLOWEST * (_FASTEST / _SLOWEST) ** uniform(crops, _WAVES, 1)  # Hz
        wave = torch.sin(2 * math.pi * (frequency * time + uniform(crops, _WAVES, 1)))  # (b, waves, n)
        load = (wave * normal(crops, _WAVES, 1)).sum(1, keepdim=True) * normal(crops, cells, 1)
        x = x + chosen(how.load) * how.load_amplitude * load
    if how.noise:
        least, most = how.noise_range
        deviation = least * (most / least) ** uniform(crops, 1, 1)
        x = x + chosen(how.noise) * deviation * normal(crops, cells, samples)
    x = torch.round(x)
    if how.dead:
        order = uniform(crops, cells).argsort(1)[:, :, None]  # (b, cells, 1)
        dead = (order == 0) | ((order == 1) & chosen(0.5))
        x = x.masked_fill(dead & chosen(how.dead), 0.0)
    return x


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
    """Train a network; keep the weights with the best balanced accuracy, the last ones if it is unknown.

    Args:
        task: Network to train.
        progress: Called after each step.
    """
    began, curve, losses, best = perf_counter(), list[Check](), list[Tensor](), -math.inf
    arrays: Arrays = {}
    for step in range(1, task.steps + 1):
        losses.append(_step(task, step))
        check = None
        if step % task.check_every == 0 or step == task.steps:
            scores, loss = _evaluate(task), float(np.mean([each.item() for each in losses]))
            check = Check(step, perf_counter() - began, loss, *scores)
            losses.clear()
            curve.append(check)
            if check.balanced is None or check.balanced > best:  # the first of equals
                best, arrays = check.balanced or 0.0, task.network.arrays()
        progress(step, task.steps, check)
    return Trained(arrays, tuple(curve))


def _step(task: TrainingTask, step: int) -> Tensor:
    task.network.train()
    loss = task.loss(step)
    task.optimiser.zero_grad()
    torch.autograd.backward(loss)
    task.clip()
    task.optimiser.step()
    return loss.detach()


def _evaluate(task: TrainingTask) -> tuple[float, float | None]:
    """Return accuracy and balanced accuracy on the validation recordings, %; None: a class is missing."""
    task.network.eval()
    with torch.no_grad():
        counts = confusion(*task.predict())
    return float(accuracy(counts)), float(balanced(counts)) if counts.sum(axis=1).all() else None

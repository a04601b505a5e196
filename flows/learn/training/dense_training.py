"""Dense training: whole sequences, one label per sample.

Windowed training computes a window of 100 samples for each label. Here neighbouring samples share the
computation, which is 60 to 90 times less per epoch. Crops are drawn from all recordings. Their warm-up
samples and those without a label are masked. Slip and static have the same total weight.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any, Final, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional, utils

from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from flows.learn.training.augmentation import augmented
from flows.learn.training.learning_curve import Check, best
from flows.learn.training.recipe import Recipe
from flows.learn.training.tcn_module import DenseTcn
from operators.batch import SLIP, STATIC
from operators.errors import ParameterError

_CLIP: Final = 1.0  # maximum norm of the gradient
_LAST_RATE: Final = 0.01  # learning rate relative to its peak, at the end of the cosine


@dataclass(frozen=True, slots=True)
class Trained:
    """Trained network at its best check."""

    arrays: Mapping[str, NDArray[Any]]  # as `operators.detectors.Tcn` takes them
    curve: tuple[Check, ...]


def train_dense(
    train: Sequence[LabelledRecording],
    validation: Sequence[LabelledRecording],
    recipe: Recipe,
    *,
    progress: Callable[[int, Check | None], object] = lambda _step, _check: None,
) -> Trained:
    """Train a TCN, on a GPU if there is one.

    Args:
        train: Recordings of the train split.
        validation: Recordings that choose the best check and the end of training.
        recipe: Size of the network and course of the training.
        progress: Called after each step, with the check that was made there.

    Raises:
        ParameterError: if the training recordings are too short or lack a class, or there are no recordings
            to validate on.
    """
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    corpus = _Corpus(train, recipe, device)
    unseen = [_Sequence.of(recording, device) for recording in validation]
    if not unseen:
        raise ParameterError("train_dense", "validation", 0, "at least 1 recording")
    _seed(recipe.seed)
    network = DenseTcn(recipe).to(device)
    optimiser = torch.optim.AdamW(network.parameters(), recipe.rate, weight_decay=recipe.decay)
    began, curve, losses = perf_counter(), list[Check](), list[float]()
    arrays: Mapping[str, NDArray[Any]] = network.arrays()
    every = max(recipe.steps // recipe.checks, 1)
    for step in range(1, recipe.steps + 1):
        losses.append(_step(network, optimiser, corpus, recipe, step))
        check = None
        if step % every == 0 or step == recipe.steps:
            scores = _evaluate(network, unseen)
            check = Check(step, perf_counter() - began, float(np.mean(losses)), *scores)
            losses.clear()
            curve.append(check)
            if best(curve) is check:
                arrays = network.arrays()
        progress(step, check)
        if check and _stuck(curve, recipe.patience):
            break
    return Trained(arrays, tuple(curve))


def _step(
    network: DenseTcn, optimiser: torch.optim.Optimizer, corpus: "_Corpus", recipe: Recipe, step: int
) -> float:
    """Perform one step of the optimiser; its random numbers depend only on the seed and the step."""
    own = int(np.random.SeedSequence([recipe.seed, step]).generate_state(1, np.uint64)[0] >> 1)
    generator = torch.Generator(corpus.device)
    cast("Any", generator).manual_seed(own)
    _seed(own)  # dropout
    counts, weight, slip = corpus.crops(generator)
    network.train()
    logit = network(augmented(counts, recipe.augmentation, generator))[:, WARM_UP:]
    each = functional.binary_cross_entropy_with_logits(logit, slip, reduction="none")
    loss = (each * weight).sum() / weight.sum().clamp(min=1)
    for group in optimiser.param_groups:
        group["lr"] = recipe.rate * _relative_rate(step, recipe)
    optimiser.zero_grad()
    torch.autograd.backward(loss)
    utils.clip_grad_norm_(network.parameters(), _CLIP)
    optimiser.step()
    return float(loss.detach())


def _seed(seed: int) -> None:
    cast("Any", torch).manual_seed(seed)  # has no type annotations


def _relative_rate(step: int, recipe: Recipe) -> float:
    """Return the learning rate relative to its peak: a linear warm-up from step 1, then a cosine."""
    warm = max(round(recipe.warm_up * recipe.steps), 1)
    if step <= warm:
        return step / warm
    passed = (step - warm) / max(recipe.steps - warm, 1)
    return _LAST_RATE + (1 - _LAST_RATE) * (1 + math.cos(math.pi * min(passed, 1.0))) / 2


def _stuck(curve: Sequence[Check], patience: int) -> bool:
    return len(curve) - 1 - curve.index(best(curve)) >= patience


class _Corpus:
    """Recordings joined on the device, from which crops are drawn."""

    def __init__(self, recordings: Sequence[LabelledRecording], recipe: Recipe, device: torch.device) -> None:
        self.device, self._crop, self._batch = device, recipe.crop, recipe.batch
        usable = [recording for recording in recordings if len(recording) >= recipe.crop]
        label = np.concatenate([np.empty(0, np.int8), *(recording.label for recording in usable)])
        slip, static = int((label == SLIP).sum()), int((label == STATIC).sum())
        if not slip or not static:
            reason = f"recordings of {recipe.crop} samples or more, with slip and static among them"
            raise ParameterError("train_dense", "train", f"{slip} slip, {static} static samples", reason)
        counts = np.concatenate([recording.counts for recording in usable])
        self._counts = torch.as_tensor(counts).to(device)  # (n, 6)
        self._slip = torch.as_tensor(label == SLIP).to(device, torch.float32)  # (n,)
        weight = np.select([label == SLIP, label == STATIC], [0.5 / slip, 0.5 / static]) * len(label)
        self._weight = torch.as_tensor(weight).to(device, torch.float32)  # (n,) 0: no label
        begins = np.cumsum([0, *(len(recording) for recording in usable)])
        starts: list[NDArray[np.int64]] = [
            np.arange(a, b - recipe.crop + 1) for a, b in pairwise(begins.tolist())
        ]
        self._starts = torch.as_tensor(np.concatenate(starts)).to(device)
        self._offsets = torch.arange(recipe.crop, device=device)

    def crops(self, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Return counts (b, 6, crop), and weight (b, m) and slip (b, m) of their evaluated samples."""
        chosen = torch.randint(len(self._starts), (self._batch,), generator=generator, device=self.device)
        rows = self._starts[chosen][:, None] + self._offsets  # (b, crop)
        evaluated = rows[:, WARM_UP:]
        counts = self._counts[rows].to(torch.float32).transpose(1, 2)
        return counts, self._weight[evaluated], self._slip[evaluated]


@dataclass(frozen=True, slots=True, eq=False)
class _Sequence:
    """Recording that the network is evaluated on."""

    counts: Tensor  # (1, 6, n)
    label: NDArray[np.int8]  # (n - WARM_UP,)

    @classmethod
    def of(cls, recording: LabelledRecording, device: torch.device) -> "_Sequence":
        counts = torch.as_tensor(recording.counts).to(device, torch.float32).T[None]
        return cls(counts, recording.label[WARM_UP:])


def _evaluate(network: DenseTcn, recordings: Sequence[_Sequence]) -> tuple[float, float]:
    """Return accuracy and balanced accuracy, %."""
    network.eval()
    with torch.no_grad():
        predicted = [network(recording.counts)[0, WARM_UP:].cpu().numpy() > 0 for recording in recordings]
    slip, label = np.concatenate(predicted), np.concatenate([recording.label for recording in recordings])
    hits, rejections = slip[label == SLIP], ~slip[label == STATIC]
    balanced = 50 * (float(hits.mean()) + float(rejections.mean()))
    return 100 * float(np.concatenate((hits, rejections)).mean()), balanced

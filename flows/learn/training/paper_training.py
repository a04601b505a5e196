"""Training of the paper's networks on windows."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.augmentation import augmented
from flows.learn.training.paper_networks import paper_network
from flows.learn.training.recipe import PAPER_TOUCH, PaperRecipe
from flows.learn.training.trained_model import Progress
from flows.learn.training.training_loop import Crops, Trained, TrainingTask, fit, training_device
from operators.batch import SLIP, UNKNOWN, Flags, Reals
from operators.errors import InputError

LENGTH: Final = 100  # samples of a window
_BLOCK: Final = 1024  # windows evaluated at once
_ADAM_EPSILON: Final = 1e-7  # Keras's


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

    def spread(self) -> tuple[Reals, Reals]:
        """Return mean and standard deviation (at least 1) of each cell's counts; (6,) each."""
        counts = self._crops.counts.cpu().numpy()
        return counts.mean(axis=0, dtype=np.float64), np.maximum(counts.std(axis=0, dtype=np.float64), 1)


class _WindowedTask(TrainingTask):
    """Training of a network of the paper on windows."""

    def __init__(
        self,
        train: Sequence[LabelledRecording],
        validation: Sequence[LabelledRecording],
        recipe: PaperRecipe,
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
        self.network = paper_network(*self._windows.spread(), recipe).to(self._device)
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
        return torch.nn.functional.cross_entropy(self.network(counts.transpose(1, 2)), slip)

    def clip(self) -> None:
        """Limit the norm of the gradient of each array by itself, as Keras does."""
        for parameter in self.network.parameters():
            torch.nn.utils.clip_grad_norm_(parameter, self._recipe.clip)

    def predict(self) -> tuple[Flags, Flags]:
        blocks = np.split(np.arange(len(self._unseen)), range(_BLOCK, len(self._unseen), _BLOCK))
        predicted = torch.cat([self.network(self._unseen.take(block)).argmax(1) for block in blocks])
        return predicted.cpu().numpy() == 1, self._unseen.slip

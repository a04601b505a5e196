"""Windows of counts as a training step takes them: gathered when they are needed, never all at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.augmentation import MIRROR_X, MIRROR_Y
from operators.batch import BAROMETERS, UNKNOWN, Flags, Reals
from operators.errors import InputError

LENGTH: Final = 100  # samples
# where each cell's counts come from, in every motion of the pad that maps it onto itself
MIRRORED: Final = (
    MIRROR_X,
    MIRROR_Y,
    tuple(MIRROR_X[cell] for cell in MIRROR_Y),  # turned by 180 degrees
    tuple(range(BAROMETERS)),  # as it was
)


@dataclass(frozen=True)
class Windows:
    """The windows behind every judged sample of some recordings whose label is known."""

    counts: Tensor  # (samples, 6) int16, of all recordings one after another
    newest: NDArray[np.intp]  # (n,) where each window ends in `counts`
    slip: Flags  # (n,) the label at its newest sample

    @classmethod
    def of(cls, recordings: Sequence[LabelledRecording], device: torch.device) -> Self:
        """The windows of recordings.

        Raises:
            InputError: there is no window of slip, or none of static.
        """
        newest: list[NDArray[np.intp]] = []
        start = 0
        for recording in recordings:
            judged = recording.evaluated(1)
            newest.append(start + judged[recording.label[judged] != UNKNOWN])
            start += len(recording)
        ends = np.concatenate([np.empty(0, np.intp), *newest])
        slip = np.concatenate([np.empty(0, np.bool_), *(recording.slip for recording in recordings)])[ends]
        if not 0 < slip.sum() < len(slip):
            raise InputError("the recordings to train on", "must hold windows of slip and of static")
        counts = torch.as_tensor(np.concatenate([recording.counts for recording in recordings]))
        return cls(counts.to(device), ends, slip)

    def __len__(self) -> int:
        return len(self.newest)

    def take(self, picked: NDArray[np.intp]) -> Tensor:
        """The counts of some windows (k,), newest last; (k, 100, 6) float32."""
        rows = torch.as_tensor(self.newest[picked][:, None] + np.arange(1 - LENGTH, 1))  # (k, 100)
        return self.counts[rows.to(self.counts.device)].float()

    def balanced(self, rng: np.random.Generator) -> NDArray[np.intp]:
        """As many windows of slip as of static, each once at most, shuffled: the larger class is sampled."""
        slip, static = np.flatnonzero(self.slip), np.flatnonzero(~self.slip)
        fewer = min(len(slip), len(static))
        picked = np.concatenate([rng.permutation(slip)[:fewer], rng.permutation(static)[:fewer]])
        return rng.permutation(picked)

    def spread(self) -> tuple[Reals, Reals]:
        """Mean and standard deviation of each barometer's counts, the latter 1 at least; two of (6,)."""
        counts = self.counts.cpu().numpy()
        return counts.mean(axis=0, dtype=np.float64), np.maximum(counts.std(axis=0, dtype=np.float64), 1)


def mirrored(windows: Tensor, motions: NDArray[np.intp]) -> Tensor:
    """Each window (k, 100, 6) after one of the motions that `MIRRORED` lists (k,)."""
    order = torch.as_tensor(np.array(MIRRORED)[motions]).to(windows.device)  # (k, 6)
    return windows.gather(2, order[:, None].expand(windows.shape))


def varied(
    windows: Tensor, *, mirror: float, noise: float, rng: np.random.Generator, generator: torch.Generator
) -> Tensor:
    """Windows (k, 100, 6) with noise, each mirrored or turned, or not.

    Args:
        windows: their counts
        mirror: probability of an x flip, the same of a y flip, and of a turn by 180 degrees
        noise: counts, standard deviation
        rng: draws the motions
        generator: draws the noise, on the device of the windows
    """
    motions = rng.choice(4, len(windows), p=[mirror, mirror, mirror, 1 - 3 * mirror])
    hiss = torch.randn(windows.shape, generator=generator, device=windows.device)
    return mirrored(windows, motions) + noise * hiss

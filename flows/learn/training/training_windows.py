"""Windows of counts for training, gathered per batch to save memory."""

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
# source of each cell's counts, for each symmetry of the pad
MIRRORED: Final = (
    MIRROR_X,
    MIRROR_Y,
    tuple(MIRROR_X[cell] for cell in MIRROR_Y),  # turned by 180 degrees
    tuple(range(BAROMETERS)),  # unchanged
)


@dataclass(frozen=True)
class Windows:
    """Windows that end at the evaluated samples of recordings with a known label."""

    counts: Tensor  # (samples, 6) int16, all recordings joined
    newest: NDArray[np.intp]  # (n,) index in `counts` of the end of each window
    slip: Flags  # (n,) label at the newest sample

    @classmethod
    def of(cls, recordings: Sequence[LabelledRecording], device: torch.device) -> Self:
        """Return the windows of recordings.

        Raises:
            InputError: if there is no window of slip, or none of static.
        """
        newest: list[NDArray[np.intp]] = []
        start = 0
        for recording in recordings:
            evaluated = recording.evaluated(1)
            newest.append(start + evaluated[recording.label[evaluated] != UNKNOWN])
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
        """Return the counts of some windows (k,), newest last; (k, 100, 6) float32."""
        rows = torch.as_tensor(self.newest[picked][:, None] + np.arange(1 - LENGTH, 1))  # (k, 100)
        return self.counts[rows.to(self.counts.device)].float()

    def balanced(self, rng: np.random.Generator) -> NDArray[np.intp]:
        """Return as many windows of slip as of static, shuffled; the larger class is sampled."""
        slip, static = np.flatnonzero(self.slip), np.flatnonzero(~self.slip)
        fewer = min(len(slip), len(static))
        picked = np.concatenate([rng.permutation(slip)[:fewer], rng.permutation(static)[:fewer]])
        return rng.permutation(picked)

    def spread(self) -> tuple[Reals, Reals]:
        """Return mean and standard deviation (at least 1) of each cell's counts; (6,) each."""
        counts = self.counts.cpu().numpy()
        return counts.mean(axis=0, dtype=np.float64), np.maximum(counts.std(axis=0, dtype=np.float64), 1)


def mirrored(windows: Tensor, symmetries: NDArray[np.intp]) -> Tensor:
    """Apply to each window (k, 100, 6) the symmetry in `MIRRORED` with this index (k,)."""
    order = torch.as_tensor(np.array(MIRRORED)[symmetries]).to(windows.device)  # (k, 6)
    return windows.gather(2, order[:, None].expand(windows.shape))


def varied(
    windows: Tensor, *, mirror: float, noise: float, rng: np.random.Generator, generator: torch.Generator
) -> Tensor:
    """Mirror or turn some of the windows (k, 100, 6), and add noise to all.

    Args:
        windows: Counts.
        mirror: Probability of each: x flip, y flip, turn by 180 degrees.
        noise: Standard deviation, counts.
        rng: Generator of the symmetries.
        generator: Generator of the noise, on the device of the windows.
    """
    symmetries = rng.choice(4, len(windows), p=[mirror, mirror, mirror, 1 - 3 * mirror])
    deviates = torch.randn(windows.shape, generator=generator, device=windows.device)
    return mirrored(windows, symmetries) + noise * deviates

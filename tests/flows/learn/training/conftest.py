import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording


def separable(seed: int, samples: int = 700) -> LabelledRecording:
    """A recording in which slip shakes every cell and static does not."""
    rng = np.random.default_rng(seed)
    label = np.repeat(rng.permutation(np.arange(samples // 50 + 1) % 2), 50)[:samples].astype(np.int8)
    counts = rng.normal(0, np.where(label == 1, 40.0, 1.0)[:, None], (samples, 6)).round().astype(np.int16)
    return LabelledRecording(counts, label, split="train")


@pytest.fixture(scope="session")
def recordings() -> list[LabelledRecording]:
    return [separable(seed) for seed in range(6)]

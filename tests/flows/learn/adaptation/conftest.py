"""Recordings of strokes that shear the pad, and a network that learned short, strong ones."""

from collections.abc import Callable

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.dense_training import train_dense
from flows.learn.training.recipe import Recipe
from operators.detectors import Tcn

Stroked = Callable[..., LabelledRecording]
_CELLS = np.array([1.0, 0.6, 0.3, -0.9, -0.5, -0.4])  # response to shear


def stroked(
    seed: int, stroke: float = 0.5, amplitude: float = 120.0, seconds: float = 30.0
) -> LabelledRecording:
    """A finger that rests 1.5 to 3 s between strokes; friction shears the pad while it slides."""
    rng = np.random.default_rng(seed)
    shear, label, sign = list[float](), list[int](), 1.0
    while len(shear) < 100 * seconds:
        rest, slide = round(100 * rng.uniform(1.5, 3)), round(100 * stroke * rng.uniform(0.9, 1.1))
        last = shear[-1] if shear else 0.0
        shear += [last * 0.4 + last * 0.6 * np.exp(-k / 12) for k in range(rest)]
        wave = np.cumsum(rng.normal(0, 0.03, slide))
        shear += [(sign + wave[k]) * (1 - np.exp(-k / 8)) + shear[-1] * np.exp(-k / 8) for k in range(slide)]
        label += [0] * rest + [1] * slide
        sign = -sign
    size = round(100 * seconds)
    counts = amplitude * np.array(shear)[:size, None] * _CELLS + rng.normal(0, 1.5, (size, 6))
    return LabelledRecording(
        np.rint(counts).astype(np.int16), np.array(label[:size], np.int8), "plane", name=f"stroked-{seed}"
    )


@pytest.fixture(scope="session")
def strokes() -> Stroked:
    return stroked


@pytest.fixture(scope="session")
def learned() -> Tcn:
    """A small network that learned strokes of 0.5 s and 120 counts."""
    recipe = Recipe(filters=6, units=8, steps=150, batch=8, crop=400, checks=1, rate=1e-2)
    return Tcn(train_dense([stroked(seed) for seed in range(4)], [stroked(4)], recipe).arrays)

"""Random changes of counts that keep their labels, and strokes of slower hands.

Training stretches each crop by a random factor and multiplies its counts by a random gain. Recordings that
choose the checkpoint, calibrate the probability or are scored get the geometric mean of both.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.recipe import Augmentation
from operators.batch import Counts, Reals
from operators.fingertip import TAKKTILE, Fingertip

MIRROR_X: Final = TAKKTILE.mirrored()
MIRROR_Y: Final = TAKKTILE.mirrored(upside_down=True)
SPREAD: Final = 1.35  # largest ratio of a crop's factor to the stretch, or of the stretch to it
GAIN: Final = (2.0, 10.0)  # least and largest gain
_WAVES: Final = 3  # sines in a change of load
_SLOWEST: Final = 0.1  # Hz
_FASTEST: Final = 2.0  # Hz


def stretched(recording: LabelledRecording, factor: int) -> LabelledRecording:
    """Return a recording that lasts `factor` times as long, with the mean gain; the recording itself for 1.

    Counts are interpolated, and each sample has the labels of the nearest one.
    """
    if factor == 1:
        return recording
    place = np.arange(int((len(recording) - 1) * factor) + 1) / factor  # samples of the recording
    rows = np.rint(place).astype(np.intp)
    old = np.arange(len(recording))
    cells: list[Reals] = [np.interp(place, old, cell) for cell in recording.counts.T.astype(np.float64)]
    limits, gain = np.iinfo(np.int16), math.sqrt(math.prod(GAIN))
    rounded = np.rint(gain * np.array(cells).T)
    counts: Counts = np.clip(rounded, limits.min, limits.max).astype(np.int16)
    return replace(
        recording,
        counts=counts,
        label=recording.label[rows],
        sliding=None if recording.sliding is None else recording.sliding[rows],
        valid=None,
        strokes=None,
        by_hand=None,
    )


def stretches(crops: int, stretch: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return the factor by which each crop lasts longer, and its gain; (crops,) each, log-uniform."""
    if stretch == 1:
        one = torch.ones(crops, device=generator.device)
        return one, one
    time, gain = torch.rand(2, crops, generator=generator, device=generator.device)
    least, most = GAIN
    return stretch * SPREAD ** (2 * time - 1), least * (most / least) ** gain


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

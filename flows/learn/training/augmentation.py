"""Random changes of counts that keep their labels."""

import math
from typing import Final

import torch
from torch import Tensor

from flows.learn.training.recipe import Augmentation
from operators.batch import BAROMETERS

MIRROR_X: Final = (2, 1, 0, 5, 4, 3)  # cells 5 4 3 above 0 1 2
MIRROR_Y: Final = (5, 4, 3, 2, 1, 0)
_RATE: Final = 100.0  # Hz
_WAVES: Final = 3  # sines in a change of load
_SLOWEST: Final = 0.1  # Hz
_FASTEST: Final = 2.0  # Hz


def augmented(counts: Tensor, how: Augmentation, generator: torch.Generator) -> Tensor:
    """Augment counts (b, 6, n) at random, each crop independently."""
    crops, _, samples = counts.shape
    device = counts.device

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, device=device)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, device=device)

    def chosen(probability: float) -> Tensor:
        return (uniform(crops) < probability)[:, None, None]  # (b, 1, 1)

    x = torch.where(chosen(how.flip), counts[:, MIRROR_X], counts)
    x = torch.where(chosen(how.flip), x[:, MIRROR_Y], x)
    if how.gain:
        spread = how.gain_spread * (normal(crops, 1, 1) + 0.8 * normal(crops, BAROMETERS, 1))
        x = x * torch.exp(chosen(how.gain) * spread)
    if how.load:
        time = torch.arange(samples, device=device) / _RATE  # (n,) s
        frequency = _SLOWEST * (_FASTEST / _SLOWEST) ** uniform(crops, _WAVES, 1)  # Hz
        wave = torch.sin(2 * math.pi * (frequency * time + uniform(crops, _WAVES, 1)))  # (b, waves, n)
        load = (wave * normal(crops, _WAVES, 1)).sum(1, keepdim=True) * normal(crops, BAROMETERS, 1)
        x = x + chosen(how.load) * how.load_amplitude * load
    if how.noise:
        least, most = how.noise_range
        deviation = least * (most / least) ** uniform(crops, 1, 1)
        x = x + chosen(how.noise) * deviation * normal(crops, BAROMETERS, samples)
    x = torch.round(x)
    if how.dead:
        order = uniform(crops, BAROMETERS).argsort(1)[:, :, None]  # (b, 6, 1)
        dead = (order == 0) | ((order == 1) & chosen(0.5))
        x = x.masked_fill(dead & chosen(how.dead), 0.0)
    return x

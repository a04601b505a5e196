"""Random changes of counts that keep their labels."""

import math
from typing import Final

import torch
from torch import Tensor

from flows.learn.training.recipe import Augmentation
from operators.fingertip import TAKKTILE, Fingertip

_WAVES: Final = 3  # sines in a change of load
_SLOWEST: Final = 0.1  # Hz
_FASTEST: Final = 2.0  # Hz


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

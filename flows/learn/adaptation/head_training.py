"""Training of the dense layers of a TCN on a few thousand samples; its convolutions stay as they are."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from torch.nn import functional

from flows.learn.training.tcn_module import DenseTcn
from flows.learn.training.training_loop import Arrays
from flows.run.executor import one_thread
from operators.batch import SLIP, UNKNOWN, Codes, Counts
from operators.detectors import Tcn

_STEPS: Final = 150  # of Adam, each on all samples
_RATE: Final = 2e-3  # learning rate at the start; half a cosine follows


def train_head(tcn: Tcn, recordings: Sequence[tuple[Counts, Codes]]) -> Arrays:
    """Train the dense layers of a network, from their weights on; both classes have the same weight.

    The result depends only on the arguments: there is no randomness. 3000 samples take about a second.

    Args:
        tcn: Trained network.
        recordings: Counts (n, cells) and labels (n,) of each. Samples before the first window are ignored.
    """
    with one_thread():  # for so little work, waiting for other threads takes longer than the work
        return _trained(tcn, recordings)


def _trained(tcn: Tcn, recordings: Sequence[tuple[Counts, Codes]]) -> Arrays:
    network = DenseTcn.of_detector(tcn)
    network.convs.requires_grad_(requires_grad=False)
    inputs, labels = list[torch.Tensor](), list[Codes]()
    for counts, label in recordings:
        known = np.flatnonzero(label[tcn.length - 1 :] != UNKNOWN) + tcn.length - 1
        with torch.no_grad():
            hidden = network.hidden(torch.as_tensor(counts, dtype=torch.float32).T[None])
        inputs.append(hidden[0, :, torch.as_tensor(known)])  # (filters, m)
        labels.append(label[known])
    slip = np.concatenate(labels) == SLIP
    share = slip.mean()
    hidden, target = torch.cat(inputs, 1)[None], torch.as_tensor(slip, dtype=torch.float32)
    weight = torch.as_tensor(np.where(slip, 0.5 / share, 0.5 / (1 - share)), dtype=torch.float32)
    parameters = [each for each in network.parameters() if each.requires_grad]
    optimiser = _adam(parameters)
    for step in range(_STEPS):
        for group in optimiser.param_groups:
            group["lr"] = _RATE * (1 + math.cos(math.pi * step / _STEPS)) / 2
        logit = network.classified(hidden)[0]
        loss = functional.binary_cross_entropy_with_logits(logit, target, weight)
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        optimiser.step()
    return network.arrays()


def _adam(parameters: Sequence[torch.nn.Parameter]) -> torch.optim.Optimizer:
    return torch.optim.Adam(parameters, _RATE)

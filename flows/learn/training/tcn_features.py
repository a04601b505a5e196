"""Features of the TCN: the outputs of its last convolution, which its heads read."""

import numpy as np
import torch

from flows.learn.training.tcn_module import DenseTcn
from operators.batch import Counts, Reals
from operators.detectors import Tcn


def features(tcn: Tcn, counts: Counts) -> Reals:
    """Return the features (n, filters) of counts (n, cells), zero-padded before the first sample."""
    with torch.no_grad():
        hidden = DenseTcn.of_detector(tcn).hidden(torch.as_tensor(counts.astype(np.float32)).T[None])
    found: Reals = hidden[0].T.numpy().astype(np.float64)
    return found


def velocities(tcn: Tcn, counts: Counts) -> Reals:
    """Return the estimates of the velocity head at each sample of counts (n, cells).

    Returns:
        (n, 4) vx and vy, mm/s, and the natural logarithm of the standard deviation of each.
    """
    *hidden, last = tcn.heads.velocity
    x = features(tcn, counts)
    for layer in hidden:
        x = np.maximum(x @ layer.kernel[0] + layer.bias, 0)
    found: Reals = x @ last.kernel[0] + last.bias
    return found

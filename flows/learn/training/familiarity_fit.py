"""Familiarity of the TCN with its input, fitted to the recordings that it was trained on."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.signal import lfilter

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.sampling import WARM_UP
from flows.learn.training.tcn_features import features
from flows.learn.training.trained_model import Arrays
from operators.batch import Reals
from operators.detectors import Tcn
from operators.detectors.tcn_heads import Familiarity

SAMPLES: Final = 100  # time constant of the mean of the features
SHARE: Final = 0.01  # of the validation samples that are doubtful
_RIDGE: Final = 1e-3  # of the mean variance, added to each
_HOP: Final = 10  # samples between those that the fit uses: their means hardly differ


def familiarity_of(
    tcn: Tcn, train: Sequence[LabelledRecording], validation: Sequence[LabelledRecording]
) -> Arrays:
    """Fit the familiarity to the train split; `SHARE` of the samples of validation exceed its limit."""
    means = np.concatenate([_means(tcn, each, SAMPLES)[::_HOP] for each in train])
    covariance = np.cov(means.T)
    variance, axes = np.linalg.eigh(
        covariance + _RIDGE * np.diag(covariance).mean() * np.eye(len(covariance))
    )
    mean, whitening = means.mean(axis=0).astype(np.float32), (axes / np.sqrt(variance)).astype(np.float32)
    others = np.concatenate([_means(tcn, each, SAMPLES) for each in validation])
    limit = np.quantile((((others - mean) @ whitening) ** 2).sum(axis=1), 1 - SHARE)
    return {
        "familiar/mean": mean,
        "familiar/whitening": whitening,
        "familiar/limit": np.array([limit], np.float32),
        "familiar/samples": np.array([SAMPLES], np.float32),
    }


def distances(tcn: Tcn, familiarity: Familiarity, recording: LabelledRecording) -> Reals:
    """Return the squared distance (n - WARM_UP,) of the samples from the end of the warm-up on."""
    means = _means(tcn, recording, float(familiarity.samples))
    distance: Reals = (((means - familiarity.mean) @ familiarity.whitening) ** 2).sum(axis=1)
    return distance


def _means(tcn: Tcn, recording: LabelledRecording, samples: float) -> Reals:
    """Return the exponential mean of the features (n - WARM_UP, filters) from the end of the warm-up on."""
    found = features(tcn, recording.counts)[WARM_UP:]
    keep = 1 - 1 / samples
    mean: Reals = lfilter([1 - keep], [1, -keep], found, axis=0, zi=keep * found[:1])[0]
    return mean

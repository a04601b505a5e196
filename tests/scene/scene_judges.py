"""Detectors that are evaluated on the scene, and their predictions."""

from collections.abc import Sequence

import numpy as np

from flows.learn.evaluation.baselines import Logistic
from flows.learn.evaluation.motion_metrics import MotionConfusions
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import labels, probabilities, windows
from operators.batch import SLIP, STATIC, Flags
from operators.detectors import Detector, Psd


def predictions(detector: Detector, recordings: Sequence[LabelledRecording], hop: int) -> list[Flags]:
    """Return True where the detector predicts slip, for the evaluated samples of each recording."""
    return [probabilities(detector, each)[each.evaluated(hop)] > 1 / 2 for each in recordings]


def confusion(detector: Detector, recordings: Sequence[LabelledRecording], hop: int) -> Confusion:
    """Return the confusion of a detector on all recordings together."""
    return Confusion.of(np.concatenate(predictions(detector, recordings, hop)), labels(recordings, hop))


def by_motion(detector: Detector, recordings: Sequence[LabelledRecording], hop: int) -> MotionConfusions:
    """Return the confusion of a detector by kind of motion."""
    evaluated = [each.evaluated(hop) for each in recordings]
    return MotionConfusions.of(recordings, evaluated, predictions(detector, recordings, hop))


def fit(recordings: Sequence[LabelledRecording], hop: int) -> tuple[Psd, Logistic]:
    """Fit the two detectors that need no training framework."""
    slip = labels(recordings, hop)
    codes = np.where(slip, SLIP, STATIC).astype(np.int8)
    psd, length = Psd(), 41
    short, long = (
        np.concatenate([windows(each, n, hop) for each in recordings]) for n in (psd.length, length)
    )
    return psd.fitted(short, codes), Logistic.fitted(long, slip)

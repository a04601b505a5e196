"""Detectors that judge the scene, and their answers."""

from collections.abc import Sequence

import numpy as np

from flows.learn.evaluation.logistic import Logistic
from flows.learn.evaluation.motion_metrics import Cells
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import labels, probabilities, windows
from operators.batch import SLIP, STATIC, Flags
from operators.detectors import Detector, Psd


def answers(detector: Detector, trials: Sequence[LabelledRecording], hop: int) -> list[Flags]:
    """Whether the detector calls each judged sample of each trial slip."""
    return [probabilities(detector, trial)[trial.evaluated(hop)] > 1 / 2 for trial in trials]


def confusion(detector: Detector, trials: Sequence[LabelledRecording], hop: int) -> Confusion:
    """The detector's answers to all trials, counted."""
    return Confusion.of(np.concatenate(answers(detector, trials, hop)), labels(trials, hop))


def cells(detector: Detector, trials: Sequence[LabelledRecording], hop: int) -> Cells:
    """The same by kind of motion."""
    return Cells.of(trials, [trial.evaluated(hop) for trial in trials], answers(detector, trials, hop))


def fitted(trials: Sequence[LabelledRecording], hop: int) -> tuple[Psd, Logistic]:
    """The two detectors that need no training framework, fitted to trials."""
    slip = labels(trials, hop)
    codes = np.where(slip, SLIP, STATIC).astype(np.int8)
    psd, length = Psd(), 41
    seen = [np.concatenate([windows(trial, n, hop) for trial in trials]) for n in (psd.length, length)]
    return psd.fitted(seen[0], codes), Logistic.fitted(seen[1], slip)

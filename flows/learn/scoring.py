"""Scores of a detector on a labelled recording, sample by sample, and windows to fit detectors to."""

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flows.learn.labelled_recordings import LabelledRecording
from operators import Score
from operators.batch import Counts, Flags, Reals, Zeroed
from operators.detectors.detector import Detector


def probabilities(detector: Detector, recording: LabelledRecording) -> Reals:
    """Return the probability of slip at each sample, as `Score` computes it in a live run.

    Returns:
        (n,) NaN during the warm-up or before the first full window, and where `Score` returns NaN.

    Raises:
        FingertipError: if the detector was made for another fingertip.
    """
    score = Score(detector)
    score.output_fingertip(recording.fingertip)
    probability = np.full(len(recording), np.nan)
    if len(recording):
        scores = score.push(_zeroed(recording)).probability
        probability[len(recording) - len(scores) :] = scores
        probability[: recording.sampling.warm_up] = np.nan
    return probability


def windows(recording: LabelledRecording, length: int, hop: int) -> Counts:
    """Return the windows (k, length, cells) that end at the evaluated samples with a known label."""
    ends = recording.known(hop)
    if not len(ends):  # it may be shorter than a window
        return np.empty((0, length, recording.counts.shape[1]), recording.counts.dtype)
    view = sliding_window_view(recording.counts, length, axis=0)  # (n - length + 1, cells, length)
    picked: Counts = view[ends + 1 - length].transpose(0, 2, 1)
    return picked


def labels(recordings: Sequence[LabelledRecording], hop: int) -> Flags:
    """Return True for each evaluated sample with a known label that is labelled slip; (k,)."""
    return np.concatenate([recording.slip[recording.known(hop)] for recording in recordings])


def _zeroed(recording: LabelledRecording) -> Zeroed:
    counts, valid = recording.counts, recording.valid
    time = recording.sampling.times(len(counts))
    return Zeroed(
        time, counts, np.zeros_like(counts), np.ones(counts.shape, np.bool_) if valid is None else valid
    )

"""What a detector sees of a recording, and what it says of it sample by sample."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flows.learn.labelled_recordings import JUDGED, Trial
from operators.batch import BAROMETERS, Counts, Flags, Reals
from operators.detectors.detector import Detector, Streaming
from operators.score import MISSING

_BLOCK: Final = 512  # windows scored at once


def probabilities(detector: Detector, trial: Trial) -> Reals:
    """The probability of slip at each sample of a trial.

    A streaming detector streams; any other is given overlapping windows, which are not copied.

    Returns:
        (n,) NaN before sample `JUDGED` or the first full window, and where more than three cells did not
        answer
    """
    found = np.full(len(trial), np.nan)
    first = max(JUDGED, detector.length - 1)
    if len(trial) <= first:
        return found
    if isinstance(detector, Streaming):
        found[first:] = detector.stream().push(trial.counts[:, None])[first:, 0]
    else:
        windows = sliding_window_view(trial.counts, detector.length, axis=0).transpose(0, 2, 1)
        for at in range(first, len(trial), _BLOCK):
            begin = at + 1 - detector.length
            found[at : at + _BLOCK] = detector.score(windows[begin : begin + _BLOCK])
    if trial.valid is not None:
        found[BAROMETERS - trial.valid.sum(axis=1) > MISSING] = np.nan
    return found


def windows(trial: Trial, length: int, hop: int) -> Counts:
    """The windows (k, length, 6) behind the judged samples of a trial."""
    view = sliding_window_view(trial.counts, length, axis=0)  # (n - length + 1, 6, length)
    picked: Counts = view[trial.judged(hop) + 1 - length].transpose(0, 2, 1)
    return picked


def labels(trials: Sequence[Trial], hop: int) -> Flags:
    """Whether each judged sample of the trials is slip; (k,)."""
    return np.concatenate([trial.slip[trial.judged(hop)] for trial in trials])

"""What a detector sees of a recording, and what it says of it sample by sample."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flows.learn.labelled_recordings import JUDGED, LabelledRecording
from operators.batch import BAROMETERS, Counts, Flags, Reals
from operators.detectors.detector import Detector, Streaming
from operators.score import MISSING

_BLOCK: Final = 512  # windows scored at once


def probabilities(detector: Detector, recording: LabelledRecording) -> Reals:
    """The probability of slip at each sample of a recording.

    A streaming detector streams; any other is given overlapping windows, which are not copied.

    Returns:
        (n,) NaN before sample `JUDGED` or the first full window, and where more than three cells did not
        answer
    """
    found = np.full(len(recording), np.nan)
    first = max(JUDGED, detector.length - 1)
    if len(recording) <= first:
        return found
    if isinstance(detector, Streaming):
        found[first:] = detector.stream().push(recording.counts[:, None])[first:, 0]
    else:
        windows = sliding_window_view(recording.counts, detector.length, axis=0).transpose(0, 2, 1)
        for at in range(first, len(recording), _BLOCK):
            begin = at + 1 - detector.length
            found[at : at + _BLOCK] = detector.score(windows[begin : begin + _BLOCK])
    if recording.valid is not None:
        found[BAROMETERS - recording.valid.sum(axis=1) > MISSING] = np.nan
    return found


def windows(recording: LabelledRecording, length: int, hop: int) -> Counts:
    """The windows (k, length, 6) behind the judged samples of a recording."""
    view = sliding_window_view(recording.counts, length, axis=0)  # (n - length + 1, 6, length)
    picked: Counts = view[recording.judged(hop) + 1 - length].transpose(0, 2, 1)
    return picked


def labels(recordings: Sequence[LabelledRecording], hop: int) -> Flags:
    """Whether each judged sample of the recordings is slip; (k,)."""
    return np.concatenate([recording.slip[recording.judged(hop)] for recording in recordings])

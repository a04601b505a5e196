"""Recordings that last longer, as the strokes of a slower hand do, with the counts of another fingertip.

Training stretches each crop by a random factor and multiplies its counts by a random gain. Recordings that
choose the checkpoint, calibrate the probability or are scored get the geometric mean of both.
"""

from dataclasses import replace
from math import prod, sqrt
from typing import Final

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import Counts, Reals

SPREAD: Final = 1.35  # largest ratio of a crop's factor to the stretch, or of the stretch to it
GAIN: Final = (2.0, 10.0)  # least and largest gain


def stretched(recording: LabelledRecording, factor: int) -> LabelledRecording:
    """Return a recording that lasts `factor` times as long, with the mean gain; the recording itself for 1.

    Counts are interpolated, and each sample has the labels of the nearest one.
    """
    if factor == 1:
        return recording
    place = np.arange(int((len(recording) - 1) * factor) + 1) / factor  # samples of the recording
    rows = np.rint(place).astype(np.intp)
    old = np.arange(len(recording))
    cells: list[Reals] = [np.interp(place, old, cell) for cell in recording.counts.T.astype(np.float64)]
    limits = np.iinfo(np.int16)
    counts: Counts = np.clip(np.rint(sqrt(prod(GAIN)) * np.array(cells).T), limits.min, limits.max).astype(
        np.int16
    )
    return replace(
        recording,
        counts=counts,
        label=recording.label[rows],
        sliding=None if recording.sliding is None else recording.sliding[rows],
        valid=None,
        force=None,
        oblique=None,
        degraded=None,
        by_hand=None,
        zeroing=recording.zeroing * factor,
        span=None,
    )

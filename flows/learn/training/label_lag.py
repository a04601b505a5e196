"""Delay of labels after the signal, estimated from each recording.

The two streams have separate clocks, and the arm's motion arrives late. A detector that is trained on such
labels learns the same delay. Counts change while the contact slides, so the lag of a recording is the shift
at which its labels correlate best with the rate of change. On the simulated rig it is 80 ms less than the
arm's latency, because the fingertip is compliant.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import SLIP, UNKNOWN, Reals, ms

LATEST: Final = 0.6  # s, maximum lag
_EARLIEST: Final = -0.4  # s, minimum lag
_SMOOTH: Final = 30 * ms  # ns
_CLEAR: Final = 0.3  # minimum correlation of a usable recording


def lags(recordings: Sequence[LabelledRecording]) -> Reals:
    """Return the delay of each recording's labels after the signal, s; (k,).

    A recording without a clear correlation (no slip, or a flat signal) gets the median of the others, or 0.
    """
    found = [_peak(recording) for recording in recordings]
    clear = [lag for lag, correlation in found if correlation >= _CLEAR]
    usual = float(np.median(clear)) if clear else 0.0
    return np.array([lag if correlation >= _CLEAR else usual for lag, correlation in found])


def relabelled(recordings: Sequence[LabelledRecording], lag: float) -> list[LabelledRecording]:
    """Return the recordings with their labels shifted to come `lag` (s) after the signal.

    Labels by hand were given on the signal and stay.
    """
    rates = np.array([recording.sampling.rate for recording in recordings])
    shifts = np.rint((lags(recordings) - lag) * rates).astype(int).tolist()
    return [_shifted(recording, shift) for recording, shift in zip(recordings, shifts, strict=True)]


def _shifted(recording: LabelledRecording, earlier: int) -> LabelledRecording:
    """Move the labels `earlier` samples towards the start; samples without a label become unknown."""
    label = np.full_like(recording.label, UNKNOWN)
    size = max(len(label) - abs(earlier), 0)
    if earlier >= 0:
        label[:size] = recording.label[earlier:]
    else:
        label[-earlier:] = recording.label[:size]
    if recording.by_hand is not None:
        label[recording.by_hand] = recording.label[recording.by_hand]
    return replace(recording, label=label)


def _peak(recording: LabelledRecording) -> tuple[float, float]:
    """Return the lag (s) of the best correlation, and the correlation."""
    steps = np.diff(recording.counts.astype(np.float64), axis=0, prepend=recording.counts[:1])  # (n, 6)
    activity = np.log1p(np.sqrt(np.square(steps).sum(axis=1)))  # (n,)
    sampling = recording.sampling
    smooth, rate = sampling.samples(_SMOOTH), sampling.rate
    activity = np.convolve(activity, np.full(smooth, 1 / smooth), "same")
    slip = (recording.label == SLIP).astype(np.float64)
    shifts = np.arange(round(_EARLIEST * rate), round(LATEST * rate) + 1)
    first = max(sampling.warm_up, -int(shifts[0]))
    inner = np.arange(first, len(slip) - int(shifts[-1]))  # evaluated at every shift
    if len(inner) < 2 or slip[inner].std() == 0 or activity[inner].std() == 0:  # noqa: PLR2004 no correlation
        return 0.0, 0.0
    signal = activity[inner] - activity[inner].mean()
    found = [float(signal @ (slip[inner + k] - slip[inner + k].mean())) for k in shifts.tolist()]
    spread = [max(float(slip[inner + k].std()), 1e-9) for k in shifts.tolist()]
    correlation = np.array(found) / (np.array(spread) * signal.std() * len(inner))  # (shifts,)
    best = int(correlation.argmax())
    fine = 0.0
    if 0 < best < len(shifts) - 1:  # a parabola through the peak and its neighbours
        before, peak, after = correlation[best - 1 : best + 2].tolist()
        fine = (before - after) / (2 * (before - 2 * peak + after) or 1.0)
    return float(shifts[best] + fine) / rate, float(correlation[best])

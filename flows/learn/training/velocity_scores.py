"""Errors of the direction and the speed of slips that a network estimates."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import SLIP, Reals, ms
from operators.detectors import Detector, Tcn

_RIGHT: Final = 45.0  # degrees, largest error of a right direction
_SHORTEST: Final = 50 * ms  # ns, of a slip that is judged, and of its beginning
_PLANE: Final = 2  # x and y


@dataclass(frozen=True, slots=True)
class VelocityScores:
    """Errors of the estimates over slips, each by the mean of its samples, weighted by their certainty."""

    slips: int
    direction: float  # % of slips whose direction is within 45 degrees
    begin: float  # the same by the first 50 ms of each slip
    angle: float  # degrees, median error of the direction
    speed: float  # %, median error of the speed
    constant: float  # %, median error of a constant: the median of the true speeds


def velocity_scores(detector: Detector, recordings: Sequence[LabelledRecording]) -> VelocityScores | None:
    """Judge the velocity head on true slips; None if there is no head, or no slip with a known velocity."""
    from flows.learn.training.tcn_features import velocities  # noqa: PLC0415 - imports torch

    if not isinstance(detector, Tcn) or not detector.heads.velocity:
        return None
    true, means, begins = list[Reals](), list[Reals](), list[Reals]()
    for recording in recordings:
        if recording.velocity is None:
            continue
        found = velocities(detector, recording.counts)
        for rows in _slips(recording):
            true.append(recording.velocity[rows].mean(axis=0))
            means.append(mean_velocity(found[rows]))
            begins.append(mean_velocity(found[rows[: recording.sampling.samples(_SHORTEST)]]))
    if not true:
        return None
    truth, mean, begin = (np.array(each) for each in (true, means, begins))  # (k, 2)
    angle = _angles(mean, truth)
    speed = np.hypot(*truth.T)
    return VelocityScores(
        len(truth),
        100 * float((angle <= _RIGHT).mean()),
        100 * float((_angles(begin, truth) <= _RIGHT).mean()),
        float(np.median(angle)),
        100 * float(np.median(np.abs(np.hypot(*mean.T) - speed) / speed)),
        100 * float(np.median(np.abs(np.median(speed) - speed) / speed)),
    )


def _slips(recording: LabelledRecording) -> list[NDArray[np.intp]]:
    """Return the rows (k,) with a known velocity of each slip after the warm-up."""
    assert recording.velocity is not None, "checked by the caller"
    assert recording.sliding is not None, "comes with the velocity"
    sliding = np.equal(recording.sliding, SLIP)
    known = ~np.isnan(recording.velocity[:, 0])
    known[: recording.sampling.warm_up] = False
    starts = np.flatnonzero(np.diff(sliding.astype(np.int8), prepend=0) == 1)
    rows = np.flatnonzero(known)
    parts = np.split(rows, rows.searchsorted(starts))[1:]
    return [part for part in parts if len(part) >= recording.sampling.samples(_SHORTEST)]


def mean_velocity(found: Reals) -> Reals:
    """Return the mean velocity (2,) of estimates (k, 4), weighted by the inverse of their variance."""
    weight = np.exp(-2 * found[:, _PLANE:])
    mean: Reals = (found[:, :_PLANE] * weight).sum(axis=0) / weight.sum(axis=0)
    return mean


def _angles(a: Reals, b: Reals) -> Reals:
    """Return the angles (k,) between vectors (k, 2), degrees."""
    turn = np.arctan2(a[:, 1], a[:, 0]) - np.arctan2(b[:, 1], b[:, 0])
    angle: Reals = np.abs(np.degrees(np.angle(np.exp(1j * turn))))
    return angle

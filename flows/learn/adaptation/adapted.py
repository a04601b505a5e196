"""Adaptation of a TCN to recordings without labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from flows.learn.adaptation.alignment import (
    LARGEST,
    Alignment,
    aligned,
    best_alignment,
    logits,
    standardised,
    time_scales,
)
from flows.learn.adaptation.segmentation import Segmentation, segmented, two_states
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import SLIP, STATIC, UNKNOWN, Codes, Counts, Flags
from operators.detectors import Tcn
from operators.errors import InputError
from operators.extras import require_extra

SHORTEST: Final = 20.0  # s, of all recordings together
CONTRAST: Final = 1.0  # least difference of the log activity of strokes from that of rest
AGREEMENT: Final = "balanced accuracy against rest and strokes"
_THIRDS: Final = 3
_SMOOTH: Final = 0.2  # s


@dataclass(frozen=True, slots=True, eq=False)
class Adapted:
    """Network that was adapted, compared with the network that it comes from."""

    tcn: Tcn
    alignment: Alignment
    before: float  # score of the old network on the held-out part, %
    after: float  # score of a network that was adapted to the rest, %
    measure: str  # what the score is

    @property
    def better(self) -> bool:
        """True if adaptation improved the score on the held-out part."""
        return self.after > self.before


def adapt(tcn: Tcn, recordings: Sequence[LabelledRecording]) -> Adapted:
    """Adapt a network to recordings whose labels are ignored; 30 s with rest and strokes suffice.

    1. Rest and strokes are separated by the activity of the counts (`segmented`).
    2. The time scale and the gain are chosen at which the network's score agrees best with the activity.
    3. Activity and score together give labels, from which the dense layers of the network learn.

    To judge the result, the same is first done without a third of each recording. On that third, both
    networks are compared with its rest and strokes. The result then uses all of the recordings. There is no
    randomness: the same arguments give the same network.

    Args:
        tcn: Trained network.
        recordings: Recordings of the fingertip that the network was trained for.

    Raises:
        InputError: if the train extra is missing, or the recordings are too short or have no rest or no
            strokes, as constant ones.
        FingertipError: if the fingertip has other cells, another rate or another unit.
    """
    require_extra("train", "adapt")
    for recording in recordings:
        tcn.check_fingertip(recording.fingertip)
    found = [_Part(each.counts, segmented(each.counts, each.fingertip.rate)) for each in recordings]
    _check(recordings, found)
    longest = aligned(tcn, Alignment(max(time_scales(tcn)))).length  # samples, window at any time scale
    held_out = [(each, *_third(each.segments.stroke)) for each in found]
    learned = [
        part
        for each, start, stop in held_out
        for part in (each.rows(0, start), each.rows(stop, len(each.counts)))
        if len(part.counts) > longest
    ]
    candidate, _ = _taught(tcn, learned)
    judged = [each.rows(start, stop) for each, start, stop in held_out]
    before, after = (_agreement(network, judged, longest) for network in (tcn, candidate))
    return Adapted(*_taught(tcn, found), before, after, AGREEMENT)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Part of a recording, with its rest and strokes."""

    counts: Counts  # (n, cells)
    segments: Segmentation

    def rows(self, start: int, stop: int) -> "_Part":
        """Return the samples from `start` to before `stop`."""
        return _Part(self.counts[start:stop], self.segments.rows(start, stop))


def _taught(tcn: Tcn, parts: Sequence[_Part]) -> tuple[Tcn, Alignment]:
    """Return a network whose dense layers learned from activity and score, and its alignment."""
    from flows.learn.adaptation.head_training import train_head  # noqa: PLC0415 - imports torch

    alignment = best_alignment(tcn, [(each.counts, each.segments.activity) for each in parts])
    network = aligned(tcn, alignment)
    result = type(tcn)(train_head(network, [(each.counts, _labels(network, each)) for each in parts]))
    result.fingertip = tcn.fingertip
    return result, alignment


def _labels(tcn: Tcn, part: _Part) -> Codes:
    """Return labels (n,) by activity and logit together; unknown before the first window."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    start = tcn.length - 1
    logit = np.clip(logits(tcn, part.counts)[start:], -LARGEST, LARGEST)
    evidence = standardised(part.segments.activity[start:]) + standardised(logit)
    evidence = ndimage.uniform_filter1d(evidence, max(round(_SMOOTH * tcn.fingertip.rate), 1))
    label = np.full(len(part.counts), UNKNOWN, np.int8)
    label[start:] = _codes(evidence > two_states(evidence)[0])
    return label


def _agreement(tcn: Tcn, parts: Sequence[_Part], start: int) -> float:
    """Return the balanced accuracy of a network against the strokes, from sample `start` on, %."""
    slip = np.concatenate([logits(tcn, each.counts)[start:] > 0 for each in parts])
    stroke = np.concatenate([each.segments.stroke[start:] for each in parts])
    return Confusion.of(slip, stroke).balanced


def _third(stroke: Flags) -> tuple[int, int]:
    """Return start and end of the third whose share of strokes is nearest to that of all."""
    bounds = [round(len(stroke) * each / _THIRDS) for each in range(_THIRDS + 1)]
    thirds = list(pairwise(bounds))[::-1]
    return min(thirds, key=lambda each: abs(stroke[slice(*each)].mean() - stroke.mean()))


def _check(recordings: Sequence[LabelledRecording], parts: Sequence[_Part]) -> None:
    names = ", ".join(filter(None, (each.name for each in recordings))) or "recording"
    seconds = sum(len(each) / each.fingertip.rate for each in recordings)
    if seconds < SHORTEST:
        reason = f"{seconds:.0f} s are too short to adapt to: record {SHORTEST:.0f} s or more, better 30 s"
        raise InputError(names, reason)
    if all(each.segments.contrast < CONTRAST for each in parts):
        reason = "has no rest or no strokes: record several strokes with a second of rest between them"
        raise InputError(names, reason)


def _codes(slip: Flags) -> Codes:
    return np.where(slip, SLIP, STATIC).astype(np.int8)

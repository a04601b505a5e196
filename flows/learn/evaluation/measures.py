"""What an evaluation writes down about each recording, and the statistics of its tables."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from flows.learn.evaluation.event_metrics import DECISION, EventMetrics, Slips, onsets
from flows.learn.evaluation.sample_metrics import (
    BINS,
    accuracy,
    balanced,
    calibration_gaps,
    confusion,
    distance,
    f1,
    precision,
)
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.onsets import match_onsets
from flows.report.results import (
    Statistic,
    area,
    joined,
    median,
    of_sums,
    ratio,
    result_rows,
    share,
)
from operators import Debounce, ms
from operators.batch import UNKNOWN, Flags, Reals, Times

FAR: Final = 100.0  # ms from any change of the label
AHEAD: Final = 150 * ms  # ns, largest lead over the arm-speed label; the arm's velocity is later than touch
SLIDING: Final = "sliding: "  # prefix of metrics and statistics against true sliding
_FAR: Final = "far: "  # prefix of the confusion far from any change of the label
_CONFUSION: Final = ("static as static", "static as slip", "slip as static", "slip as slip")  # label, answer
_SLIP, _STATIC = "probability if slip", "probability if static"

_Found: TypeAlias = dict[str, float | Reals]


def judged(
    recording: LabelledRecording,
    probability: Reals,
    debounce: Debounce,
    *,
    method: str,
    condition: str = "",
    fold: str = "",
) -> pl.DataFrame:
    """Compare the answers of a detector on a recording with its labels.

    Samples without an answer or a label, and those of the warm-up, do not count. Of a recording whose strokes
    are known, the samples of each kind of motion are a condition, unless there is a `condition` already.

    Args:
        recording: Recording; its name is unique within the study.
        probability: Probability of slip at each sample (n,); NaN: no answer.
        debounce: Makes events of it.
        method: Name of the detector.
        condition: What differs from the recording as it was made.
        fold: What was held out.

    Returns:
        Rows of the results table.
    """
    known = _known(recording, probability)
    predicted, raised = probability >= DECISION, onsets(probability, debounce, recording.sampling)
    parts = [(condition, known)] if condition else list(_motions(recording, known))
    key = {"method": method, "recording": recording.name, "fold": fold}
    rows = [
        result_rows(_confusion(recording, predicted, part), condition=kind, **key) for kind, part in parts
    ]
    found: _Found = {
        **_events(recording, raised),
        "events": len(raised),
        "minutes": recording.sampling.minutes(max(len(recording) - recording.sampling.warm_up, 0)),
        "lead ms": _leads(recording, raised),
    }
    if not condition:
        far = known & (distance(recording.label, recording.sampling) >= FAR)
        found |= _confusion(recording, predicted, far, _FAR)
        found |= _distribution(probability[known], recording.slip[known])
    if recording.sliding is not None:
        other = replace(recording, label=recording.sliding)
        found |= _confusion(other, predicted, _known(other, probability), SLIDING)
        found |= _events(other, raised, SLIDING)
    return joined([*rows, result_rows(found, condition=condition, **key)])


def confusion_metrics(predicted: Flags, truth: Flags, prefix: str = "") -> dict[str, float | Reals]:
    """Count predictions (k,) by truth (k,); `BALANCED` and `SHARES` are computed from these metrics."""
    counts = confusion(predicted, truth).ravel().tolist()
    return {prefix + name: count for name, count in zip(_CONFUSION, counts, strict=True)}


def motion_name(surface: str, kind: str, speed: float | None) -> str:
    """Return the condition of the samples of a kind of motion on a surface.

    >>> motion_name("plane", "oblique", 0.05), motion_name("sphere", "rotation", None)
    ('plane, oblique, 5 cm/s', 'sphere, rotation')
    """
    return f"{surface}, {kind}" + ("" if speed is None else f", {100 * speed:g} cm/s")


def _motions(recording: LabelledRecording, known: Flags) -> Iterator[tuple[str, Flags]]:
    """Yield each kind of motion, and its samples."""
    strokes = recording.strokes
    if strokes is None:
        yield "", known
    elif strokes.speed is None:
        yield motion_name(strokes.surface, "rotation", None), known
    else:
        yield motion_name(strokes.surface, "primary", strokes.speed), known & ~strokes.oblique
        yield motion_name(strokes.surface, "oblique", strokes.speed), known & strokes.oblique


def _known(recording: LabelledRecording, probability: Reals) -> Flags:
    known: Flags = np.isfinite(probability) & (recording.label != UNKNOWN)
    known[: recording.sampling.warm_up] = False
    return known


def _confusion(recording: LabelledRecording, predicted: Flags, part: Flags, prefix: str = "") -> _Found:
    return confusion_metrics(predicted[part], recording.slip[part], prefix)


def _events(recording: LabelledRecording, raised: Times, prefix: str = "") -> _Found:
    events = EventMetrics.of_onsets([raised], [Slips.labelled(recording)])
    return {
        prefix + "false alarms": events.false_alarms,
        prefix + "static minutes": events.minutes,
        prefix + "missed slips": events.missed_slips,
        prefix + "slips": events.slips,
        prefix + "delay ms": events.delays,
    }


def _leads(recording: LabelledRecording, raised: Times) -> Reals:
    """Return by how much the first onset of each slip precedes the change of the arm-speed label (k,), ms."""
    delays = match_onsets(raised, Slips.labelled(recording).found, before=AHEAD).delays
    return 0.0 - delays / ms


def _distribution(probability: Reals, slip: Flags) -> _Found:
    """Return what the area under the ROC curve and the calibration error are computed from."""
    gaps = calibration_gaps(probability, slip).tolist()
    return {
        _SLIP: probability[slip],
        _STATIC: probability[~slip],
        **{f"gap {number}": gap for number, gap in enumerate(gaps)},
    }


def _of_confusion(compute: Callable[[Reals], Reals], prefix: str = "") -> Statistic:
    """Return a statistic of confusions (..., 2, 2)."""

    def of(total: Callable[[str], Reals]) -> Reals:
        counts = np.stack([total(prefix + name) for name in _CONFUSION], axis=-1)
        return compute(counts.reshape(*counts.shape[:-1], 2, 2))

    return of_sums(of)


def _calibration(total: Callable[[str], Reals]) -> Reals:
    gaps = sum(np.abs(total(f"gap {number}")) for number in range(BINS))
    return 100 * ratio(np.asarray(gaps), sum((total(name) for name in _CONFUSION), np.zeros(1)))


def _event_statistics(prefix: str = "") -> dict[str, Statistic]:
    return {
        prefix + "false/min": share(prefix + "false alarms", prefix + "static minutes"),
        prefix + "missed %": share(prefix + "missed slips", prefix + "slips", 100),
        prefix + "delay ms": median(prefix + "delay ms"),
    }


SHARES: Final[Mapping[str, Statistic]] = {  # the paper's Table I
    "accuracy %": _of_confusion(accuracy),
    "precision %": _of_confusion(precision),
    "F1 %": _of_confusion(f1),
}
BALANCED: Final[Mapping[str, Statistic]] = {"balanced %": _of_confusion(balanced)}
SAMPLES: Final[Mapping[str, Statistic]] = {
    **BALANCED,
    "far %": _of_confusion(balanced, _FAR),  # balanced accuracy
    "AUC %": area(_SLIP, _STATIC),
    "calibration error %": of_sums(_calibration),
}
EVENTS: Final[Mapping[str, Statistic]] = {"events/min": share("events", "minutes"), **_event_statistics()}
AGAINST_SLIDING: Final[Mapping[str, Statistic]] = {
    SLIDING + "balanced %": _of_confusion(balanced, SLIDING),
    **_event_statistics(SLIDING),
    "lead ms": median("lead ms"),
}
F1: Final[Mapping[str, Statistic]] = {"F1 %": SHARES["F1 %"]}
DECIMALS: Final[Mapping[str, int | None]] = {"delay ms": 0, SLIDING + "delay ms": 0, "lead ms": 0}

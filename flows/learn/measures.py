"""What an evaluation writes down about each recording, and the statistics of its tables."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from flows.learn.event_metrics import DECISION, EventMetrics, TrueSlips, match_onsets, onsets
from flows.learn.labelled_recordings import LabelledRecording, Sampling
from flows.report.results import Statistic, area, joined, median, of_sums, ratio, result_rows, share
from operators import Debounce, minute, ms
from operators.batch import UNKNOWN, Codes, Flags, Reals, Times

FAR: Final = 100.0  # ms from any change of the label
AHEAD: Final = 150 * ms  # ns, largest lead over the arm-speed label; the arm's velocity is later than touch
SLIDING: Final = "sliding: "  # prefix of metrics and statistics against true sliding
_BINS: Final = 10  # of the probability, for the calibration error
_FAR: Final = "far: "  # prefix of the confusion far from any change of the label
CONFUSION: Final = ("static as static", "static as slip", "slip as static", "slip as slip")  # label, answer
_SLIP, _STATIC = "probability if slip", "probability if static"

_Found: TypeAlias = dict[str, float | Reals]


def confusion(predicted: Flags, truth: Flags) -> Reals:
    """Count predictions (k,) by truth (k,).

    Returns:
        (2, 2) row: static, slip; column: predicted static, slip.

    >>> confusion(np.array([True, True, False, False]), np.array([True, False, False, False])).tolist()
    [[2.0, 1.0], [0.0, 1.0]]
    """
    return np.bincount(2 * truth + predicted, minlength=4).reshape(2, 2).astype(np.float64)


def accuracy(counts: Reals) -> Reals:
    """Compute the share of correct predictions in confusions (..., 2, 2); (...) %."""
    return 100 * ratio(np.trace(counts, axis1=-2, axis2=-1), counts.sum(axis=(-2, -1)))


def balanced(counts: Reals) -> Reals:
    """Compute the balanced accuracy of confusions (..., 2, 2): the mean of both recalls; (...) %."""
    right = np.diagonal(counts, axis1=-2, axis2=-1)
    found: Reals = 100 * ratio(right, counts.sum(axis=-1)).sum(axis=-1) / 2
    return found


def precision(counts: Reals) -> Reals:
    """Compute the precision averaged over the classes by their share, as in the paper's tables; (...) %.

    The recall averaged in this way equals the accuracy. A class that is never predicted has precision 0.
    """
    return _weighted(counts, np.diagonal(counts, axis1=-2, axis2=-1), counts.sum(axis=-2))


def f1(counts: Reals) -> Reals:
    """Compute F1 averaged over the classes by their share, as in the paper's tables; (...) %."""
    right = np.diagonal(counts, axis1=-2, axis2=-1)
    return _weighted(counts, 2 * right, counts.sum(axis=-1) + counts.sum(axis=-2))


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
    known, true = _known(recording, probability), TrueSlips.labelled(recording)
    predicted, raised = probability >= DECISION, onsets(probability, debounce, true)
    parts = [(condition, known)] if condition else list(_motions(recording, known))
    key = {"method": method, "recording": recording.name, "fold": fold}
    rows = [
        result_rows(_confusion(recording, predicted, part), condition=kind, **key) for kind, part in parts
    ]
    leads = -match_onsets(raised, true.found, before=AHEAD).delays  # ns before the change of the label
    found: _Found = {
        **_events(true, raised),
        "events": len(raised),
        "minutes": true.judged / minute,
        "lead ms": leads / ms,
    }
    if not condition:
        far = known & (distance(recording.label, true.places, recording.sampling) >= FAR)
        found |= _confusion(recording, predicted, far, _FAR)
        found |= _distribution(probability[known], recording.slip[known])
    if recording.sliding is not None:
        other = replace(recording, label=recording.sliding)
        found |= _confusion(other, predicted, _known(other, probability), SLIDING)
        found |= _events(TrueSlips.labelled(other), raised, SLIDING)
    return joined([*rows, result_rows(found, condition=condition, **key)])


def distance(label: Codes, places: NDArray[np.int64], sampling: Sampling) -> Reals:
    """Return the distance of each sample (n,) from the nearest change of the label; (n,) ms.

    It is 0 for the two samples at a change, and infinite if the label never changes.

    >>> distance(np.array([0, 0, 1, 1, 1], np.int8), np.arange(5), Sampling()).tolist()
    [10.0, 0.0, 0.0, 10.0, 20.0]
    """
    changed = np.diff(label) != 0
    changes = places[np.append(changed, False) | np.insert(changed, 0, False)]  # (k,) of samples at a change
    if not len(changes):
        return np.full(len(label), np.inf)
    following = changes.searchsorted(places)  # (n,) number of the first change from each sample on
    after = np.abs(changes.take(following, mode="clip") - places)
    before = np.abs(places - changes.take(following - 1, mode="clip"))
    steps: Reals = np.minimum(before, after) * (sampling.period / ms)
    return steps


def motion_name(surface: str, kind: str, speed: float | None) -> str:
    """Return the condition of the samples of a kind of motion on a surface.

    >>> motion_name("plane", "oblique", 0.05), motion_name("sphere", "rotation", None)
    ('plane, oblique, 5 cm/s', 'sphere, rotation')
    """
    return f"{surface}, {kind}" + ("" if speed is None else f", {100 * speed:g} cm/s")


def _weighted(counts: Reals, part: Reals, whole: Reals) -> Reals:
    """Average a share of each class (..., 2) by the number of its samples; (...) %."""
    samples, shares = counts.sum(axis=-1), np.nan_to_num(ratio(part, whole))
    return 100 * ratio((samples * shares).sum(axis=-1), samples.sum(axis=-1))


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
    counts = confusion(predicted[part], recording.slip[part]).ravel().tolist()
    return {prefix + name: count for name, count in zip(CONFUSION, counts, strict=True)}


def _events(true: TrueSlips, raised: Times, prefix: str = "") -> _Found:
    events = EventMetrics.of_onsets([raised], [true])
    return {
        prefix + "false alarms": events.false_alarms,
        prefix + "static minutes": events.minutes,
        prefix + "missed slips": events.missed_slips,
        prefix + "slips": events.slips,
        prefix + "delay ms": events.delays,
    }


def _distribution(probability: Reals, slip: Flags) -> _Found:
    """Return what the area under the ROC curve and the calibration error are computed from."""
    bins = np.minimum((probability * _BINS).astype(np.intp), _BINS - 1)
    gaps = np.bincount(bins, probability - slip, _BINS).tolist()
    return {
        _SLIP: probability[slip],
        _STATIC: probability[~slip],
        **{f"gap {number}": gap for number, gap in enumerate(gaps)},
    }


def _of_confusion(compute: Callable[[Reals], Reals], prefix: str = "") -> Statistic:
    """Return a statistic of confusions (..., 2, 2)."""

    def of(total: Callable[[str], Reals]) -> Reals:
        counts = np.stack([total(prefix + name) for name in CONFUSION], axis=-1)
        return compute(counts.reshape(*counts.shape[:-1], 2, 2))

    return of_sums(of)


def _calibration(total: Callable[[str], Reals]) -> Reals:
    gaps = sum(np.abs(total(f"gap {number}")) for number in range(_BINS))
    return 100 * ratio(np.asarray(gaps), sum((total(name) for name in CONFUSION), np.zeros(1)))


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
DECIMALS: Final[Mapping[str, int | None]] = {"delay ms": 0, "lead ms": 0, "us/sample": None}

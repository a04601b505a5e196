"""Models whose card has debounce settings for a rate of false alarms."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flows.learn.alarms.alarm_calibration import Calibrated, calibrated, try_settings
from flows.learn.evaluation.folds import repeated
from flows.learn.event_metrics import debounce_settings
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.training.trained_model import learned_from, provenance
from flows.report.table import counted
from operators.errors import InputError, ParameterError
from operators.extras import software_version
from storage import files, load_detector
from storage.models import ALARMS, LIMIT, load_card, save_card, shipped


@dataclass(frozen=True, slots=True)
class CalibratedModel:
    """Model on disk with settings for a rate of false alarms."""

    path: Path
    entry: Mapping[str, Any]  # of the card
    found: Calibrated

    def report(self) -> str:
        """Return the result as text."""
        found, events, rate = self.found, self.found.measured, f"{self.found.rate:g}/min"
        rule = found.debounce
        slips = f"{events.missed:.1f} % of slips missed, median delay {np.median(events.delays):.0f} ms"
        return (
            f"threshold {rule.threshold:g}; {counted(rule.consecutive, 'decision')} to start,"
            f" {rule.release} to end: at most {found.bound:.2g} false alarms per static minute with"
            f" {100 * found.confidence:g} % confidence ({rate} wanted)\n"
            f"measured: {counted(events.false_alarms, 'false alarm')} in {events.minutes:.1f} static minutes;"
            f" {slips if events.slips else 'no slips'}\n"
            f"wrote {self.path} and its card; use it with"
            f" `slipflow run live --set detector={self.path} --set false_alarms={rate}`"
        )


def calibrate_model(
    model: str,
    paths: Sequence[Path],
    rate: float,
    confidence: float,
    *,
    out: Path | None = None,
    log: Callable[[str], object] = lambda _: None,
) -> CalibratedModel:
    """Choose the debounce of a model for a rate of false alarms, and write it into the model's card.

    Recordings that the model was trained or chosen on are left out. Settings for other rates are kept.

    Args:
        model: Name of a shipped model, or its file.
        paths: Labelled datasets or sessions.
        rate: False alarms per static minute.
        confidence: Probability that the rate is kept in recordings like these.
        out: File for a copy of the model, with its card; None: change the card of the model's file, or
            copy a shipped model into the current folder.
        log: Receives progress messages.

    Raises:
        InputError: if the model has no file, the recordings cannot be read, are all left out or repeat each
            other, or the copy of a shipped model exists.
        FingertipError: if the fingertip of the recordings differs from that of the model.
        ParameterError: if the suffix of `out` differs from that of the model.
        TooLittleDataError: if there are too few static minutes.
        OSError: if the model cannot be written.
    """
    source = shipped(model) or Path(model)
    detector = load_detector(model)
    if source.suffix != ".safetensors":
        raise InputError(model, "has no weights, so it has no card to write settings into")
    path = out or (Path(source.name) if shipped(model) else source)
    if path.suffix != source.suffix:
        raise ParameterError("calibrate", "out", str(path), f"a path that ends in {source.suffix}")
    if out is None and path != source and path.exists():
        raise InputError(str(path), "exists: calibrate it, or give another file with -o")
    card, weights = load_card(source), files.read(source, LIMIT)
    used = [(each, _unseen(model, card, each, log)) for each in paths]
    recordings = [recording for _, found in used for recording in found]
    if not recordings:
        raise InputError(
            "calibrate", "no recordings are left: give recordings that the model has not learned from"
        )
    if twice := repeated(recordings, [f"recording {number}" for number in range(1, len(recordings) + 1)]):
        raise InputError("calibrate", f"{twice[0]}: give each recording once")
    log(f"scoring {counted(len(recordings), 'recording')}")
    trials = try_settings(recordings, [one.probabilities(detector) for one in recordings])
    found = calibrated(trials, rate, confidence)
    entry = _entry(found, [provenance(*each) for each in used])
    entries = {float(each["false_alarms_per_min"]): each for each in (*card.get(ALARMS, ()), entry)}
    card |= {
        "file": path.name,
        "sha256": hashlib.sha256(weights).hexdigest(),
        ALARMS: [entries[each] for each in sorted(entries)],
    }
    if path.absolute() != source.absolute():
        files.put(path, weights)
    save_card(path, card)
    return CalibratedModel(path, entry, found)


def _unseen(
    model: str, card: Mapping[str, Any], path: Path, log: Callable[[str], object]
) -> list[LabelledRecording]:
    """Read recordings; of a dataset that the model has learned from, only those of its test split."""
    log(f"reading {path}")
    recordings = load(path)
    if not learned_from(card, path):
        return recordings
    kept = [recording for recording in recordings if recording.split == "test"]
    left_out = counted(len(recordings) - len(kept), "recording")
    log(f"left out {left_out} of {path}: {model} has learned from them")
    return kept


def _entry(found: Calibrated, data: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    events = found.measured
    return {
        "false_alarms_per_min": found.rate,
        "confidence": found.confidence,
        "bound_per_min": round(found.bound, 4),
        "debounce": debounce_settings(found.debounce),
        "measured": {
            "false_alarms": events.false_alarms,
            "static_minutes": round(events.minutes, 3),
            "slips": events.slips,
            "missed_slips": events.missed_slips,
            "onset_ms": float(np.median(events.delays)) if len(events.delays) else None,
        },
        "data": list(data),
        "software": f"slipflow {software_version()}",
    }

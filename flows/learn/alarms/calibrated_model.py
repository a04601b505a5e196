"""Models whose card has debounce settings for a rate of false alarms."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

from flows.learn.alarms.alarm_calibration import Calibrated, Trials, calibrated
from flows.learn.labelled_recordings import LabelledRecording, load, session_folders
from flows.learn.leaks.leak import SEEN, card_leaks
from flows.learn.leaks.row_hashes import shared_rows
from flows.learn.provenance import dataset_digest
from flows.learn.scoring import probabilities
from flows.report.table import counted
from operators.checks import check_choice
from operators.errors import InputError, ParameterError
from operators.software import software_version
from storage import Session, files, load_detector
from storage.layout import MANIFEST
from storage.models import ALARMS, LIMIT, load_card, save_card, shipped

UNITS: Final = ("session", "surface")
_LEARNED: Final = {"trained on", "chosen on"}  # leaks that exclude a recording
_PIECES: Final = 10  # into which a single session is cut
_RULE: Final = "threshold", "consecutive", "release"  # of a debounce


@dataclass(frozen=True, slots=True)
class CalibratedModel:
    """Model on disk with settings for a rate of false alarms."""

    path: Path
    entry: Mapping[str, Any]  # of the card
    found: Calibrated

    def report(self) -> str:
        """Return the result as text."""
        found, events, rate = self.found, self.found.measured, f"{self.found.rate:g}/min"
        rule, sessions = found.debounce, sum(len(each["sessions"]) for each in self.entry["data"])
        slips = f"{events.missed:.1f} % of slips missed, median delay {events.onset_ms:.0f} ms"
        measured = f"{counted(events.false_alarms, 'false alarm')} in {events.minutes:.1f} static minutes"
        return (
            f"threshold {rule.threshold:g}; {counted(rule.consecutive, 'decision')} to start,"
            f" {rule.release} to end: at most {found.bound:.2g} false alarms per static minute with"
            f" {100 * found.confidence:g} % confidence ({rate} wanted)\n"
            f"measured: {measured} of {counted(sessions, 'session')};"
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
    by: str = UNITS[0],
    out: Path | None = None,
    log: Callable[[str], object] = lambda _: None,
) -> CalibratedModel:
    """Choose the debounce of a model for a rate of false alarms, and write it into the model's card.

    Recordings that the model was trained or chosen on are left out. Settings for other rates are kept.

    Args:
        model: Name of a shipped model, or its file.
        paths: Labelled datasets or sessions.
        rate: False alarms per static minute.
        confidence: Probability that the rate is kept.
        by: One of `UNITS`, the exchangeable units: ``session``: the rate is kept in sessions like these, a
            single one is cut into pieces; ``surface``: also on other surfaces that are like these.
        out: File for a copy of the model, with its card; None: change the card of the model's file, or
            copy a shipped model into the current folder.
        log: Receives progress messages.

    Raises:
        InputError: if the model has no file, the recordings cannot be read, are all left out or repeat each
            other, or a shipped model would replace another one in the current folder.
        FingertipError: if the fingertip of the recordings differs from that of the model.
        ParameterError: if `by` is unknown or the suffix of `out` differs from that of the model.
        TooLittleDataError: if there are too few static minutes.
        OSError: if the model cannot be written.
    """
    check_choice("calibrate", "--by", by, UNITS)
    source = shipped(model) or Path(model)
    detector = load_detector(model)
    if source.suffix not in {".safetensors", ".npz"}:
        raise InputError(model, "has no weights, so it has no card to write settings into")
    path = out or (Path(source.name) if shipped(model) else source)
    if path.suffix != source.suffix:
        raise ParameterError("calibrate", "out", str(path), f"a path that ends in {source.suffix}")
    card, weights = load_card(source), files.read(source, LIMIT)
    known = [*card.get(ALARMS, ()), *_entries_there(path, source, weights, chosen=out is not None)]
    recordings, sessions, data = list[LabelledRecording](), list[Path](), list[dict[str, Any]]()
    for each in paths:
        log(f"reading {each}")
        used = unseen_recordings(model, card, each, log)
        folders = {Session.open(folder).name: folder for folder in session_folders(each)}
        recordings += used
        sessions += [folders[recording.name] for recording in used]
        data.append(_identity(each, [folders[name] for name in dict.fromkeys(one.name for one in used)]))
    if not recordings:
        raise InputError(
            "calibrate", "no recordings are left: give recordings that the model has not learned from"
        )
    _check_distinct(recordings)
    log(f"scoring {counted(len(recordings), 'recording')}")
    units = [one.group or one.surface for one in recordings] if by == UNITS[1] else sessions
    pieces = 1
    if len(set(units)) == 1:
        if by == UNITS[1]:
            raise InputError(
                "calibrate --by surface", f"needs several surfaces; all recordings are of {units[0]!r}"
            )
        pieces = _PIECES
    trials = Trials.of(recordings, [probabilities(detector, one) for one in recordings], pieces)
    found = calibrated(trials.pooled([*product(units, range(pieces))]), rate, confidence)
    entry = {**_entry(found, data), "by": by}
    entries = {float(each["false_alarms_per_min"]): each for each in (*known, entry)}
    card |= {
        "file": path.name,
        "sha256": hashlib.sha256(weights).hexdigest(),
        ALARMS: [entries[each] for each in sorted(entries)],
    }
    if path.absolute() != source.absolute():
        files.put(path, weights)
    save_card(path, card)
    return CalibratedModel(path, entry, found)


def unseen_recordings(
    model: str, card: Mapping[str, Any], path: Path, log: Callable[[str], object]
) -> list[LabelledRecording]:
    """Read recordings; leave out those that the model was trained or chosen on."""
    recordings = load(path)
    digest = "" if SEEN in card else dataset_digest(path)

    def leaks(judged: Sequence[LabelledRecording]) -> bool:
        return any(leak.kind in _LEARNED for leak in card_leaks(model, card, judged, digest))

    if not leaks(recordings):
        return recordings
    kept = [recording for recording in recordings if not leaks([recording])]
    left_out = counted(len(recordings) - len(kept), "recording")
    log(f"left out {left_out} of {path}: {model} has learned from them")
    return kept


def _entries_there(path: Path, source: Path, weights: bytes, *, chosen: bool) -> list[Mapping[str, Any]]:
    """Return the settings in the card of a copy of the model that is already at `path`.

    Raises:
        InputError: if another model is there, unless the user has `chosen` the path.
    """
    if path.absolute() == source.absolute() or not path.exists():
        return []
    if files.read(path, LIMIT) == weights:
        return list(load_card(path).get(ALARMS, ()))
    if not chosen:
        raise InputError(str(path), f"is not the shipped {source.stem}: give a file with -o")
    return []


def _check_distinct(recordings: Sequence[LabelledRecording]) -> None:
    """Check that no recording repeats another one.

    Raises:
        InputError: if two recordings have rows in common.
    """
    for pair in shared_rows(recordings, range(len(recordings))):
        both = f"{pair.first.name} and {pair.second.name} have {counted(pair.rows, 'row')} in common"
        reason = (
            "repeated data would show a rate with more confidence than there is; give each recording once"
        )
        raise InputError("calibrate", f"{both}: {reason}")


def _identity(path: Path, sessions: Sequence[Path]) -> dict[str, Any]:
    """Return the names of sessions and the sha256 of their manifests, which state that of every part."""
    digests = {
        session.name: hashlib.sha256(files.read(session / MANIFEST, LIMIT)).hexdigest()
        for session in sessions
    }
    return {"name": path.resolve().name, "sessions": digests}


def _entry(found: Calibrated, data: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    events = found.measured
    measured: dict[str, Any] = {
        "false_alarms": events.false_alarms,
        "static_minutes": round(events.minutes, 3),
        "slips": events.slips,
        "missed_slips": events.missed_slips,
        "onset_ms": events.onset_ms if len(events.delays) else None,
    }
    return {
        "false_alarms_per_min": found.rate,
        "confidence": found.confidence,
        "bound_per_min": round(found.bound, 4),
        "debounce": {name: getattr(found.debounce, name) for name in _RULE},
        "measured": measured,
        "data": list(data),
        "software": f"slipflow {software_version()}",
    }

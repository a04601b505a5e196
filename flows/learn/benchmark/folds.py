"""Recordings of a dataset and their folds: each surface, object or recording is judged once, unseen."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from typing import Final

import numpy as np

from flows.learn.labelled_recordings import (
    LabelledRecording,
    common_fingertip,
    hand_label_summary,
    load,
)
from flows.learn.leaks.leak import Leak, shared_leaks
from operators.errors import InputError
from operators.fingertip import RATE_TOLERANCE, Fingertip

RATE: Final = 100.0  # Hz, lowest rate of fits: the windows of slower samples would last for seconds
_MOST: Final = 8  # folds by recording
_TURN: Final = 5  # every fifth recording of a fold's training validates


@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """Recordings to judge, and the others, which detectors may learn from."""

    name: str  # of the surface, object or recordings that are judged
    train: tuple[LabelledRecording, ...]
    test: tuple[int, ...]  # places of the judged recordings in the dataset

    def parts(self) -> tuple[list[LabelledRecording], list[LabelledRecording]]:
        """Return the training recordings to fit to, and those that choose a checkpoint and a debounce.

        Of those with slip and of those without, every fifth validates. If fewer than five have slip, all do
        both, as none can be spared.
        """
        fit, validation = list[LabelledRecording](), list[LabelledRecording]()
        for with_slip in (True, False):
            alike = [each for each in self.train if bool(each.slip.any()) is with_slip]
            if with_slip and len(alike) < _TURN:
                return list(self.train), list(self.train)
            for place, each in enumerate(alike):
                (validation if place % _TURN == _TURN // 2 else fit).append(each)
        return fit, validation


@dataclass(frozen=True, slots=True, eq=False)
class BenchmarkData:
    """Labelled dataset with its folds."""

    name: str
    recordings: tuple[LabelledRecording, ...]
    folds: tuple[Fold, ...]
    by: str  # what a fold holds out: group or recording
    fingertip: Fingertip
    notes: tuple[str, ...]  # conversions and restrictions, one sentence each
    leaks: tuple[Leak, ...]  # between folds

    @property
    def minutes(self) -> float:
        """Length of all recordings."""
        return self.recordings[0].sampling.minutes(sum(map(len, self.recordings)))

    @property
    def slip(self) -> float:
        """Share of slip samples, %."""
        return 100 * float(np.concatenate([each.slip for each in self.recordings]).mean())


def load_folds(
    dataset: Path, name: str = "", rate: float | None = None, groups: Collection[str] = ()
) -> BenchmarkData:
    """Read a dataset and split it by group, or by recording if it has fewer than two groups.

    Args:
        dataset: Folder of the dataset.
        name: Name on the page (default: that of the folder).
        rate: Rate to which samples of another rate are converted, Hz; None: their own, 100 Hz at least.
        groups: Only the recordings of these groups (default: all).

    Raises:
        InputError: if it cannot be read, lacks a group, slip or static, or has one recording.
        FingertipError: if its recordings have different fingertips.
    """
    recordings = _of_groups(dataset, load(dataset, rate), groups)
    given, notes = common_fingertip(recordings).rate, list[str]()
    if rate is None and given < RATE and not isclose(given, RATE, rel_tol=RATE_TOLERANCE):
        recordings = _of_groups(dataset, load(dataset, RATE), groups)
        notes.append(f"Resample converted the samples from {given:.0f} to {RATE:g} Hz")
    if by_hand := hand_label_summary(recordings):
        notes.append(by_hand[0].upper() + by_hand[1:])
    slip = np.concatenate([each.slip for each in recordings])
    if slip.all() or not slip.any():
        missing = "static" if slip.any() else "slip"
        raise InputError(str(dataset), f"has no {missing}: a benchmark needs labels of slip and static")
    if len(recordings) < 2:  # noqa: PLR2004 - one to fit to, one to judge
        raise InputError(str(dataset), "has one recording: a benchmark needs two or more, to hold one out")
    grouped = len({each.group for each in recordings} - {""}) > 1 and all(each.group for each in recordings)
    parts = [each.group for each in recordings] if grouped else _turns(recordings)
    if not grouped:
        notes.append("It states fewer than two surfaces or objects, so each may be in training as well")
    folds = tuple(
        Fold(
            part,
            tuple(each for each, own in zip(recordings, parts, strict=True) if own != part),
            tuple(place for place, own in enumerate(parts) if own == part),
        )
        for part in dict.fromkeys(parts)
    )
    return BenchmarkData(
        name or dataset.resolve().name,
        tuple(recordings),
        folds,
        "group" if grouped else "recording",
        recordings[0].fingertip,
        tuple(notes),
        tuple(shared_leaks(recordings, parts)),
    )


def labelled_minutes(fold: Fold, minutes: float, seed: int) -> list[LabelledRecording]:
    """Return training recordings of a fold in random order, up to a total length.

    The last one is cut. The first has slip.
    """
    order: list[int] = np.random.default_rng(seed).permutation(len(fold.train)).tolist()
    first = next((place for place in order if fold.train[place].slip.any()), order[0])
    left, found = round(minutes * 60 * fold.train[0].sampling.rate), list[LabelledRecording]()
    for place in (first, *(place for place in order if place != first)):
        if left <= 0:
            break
        found.append(fold.train[place].piece(slice(left)))
        left -= len(found[-1])
    return found


def _of_groups(
    dataset: Path, recordings: list[LabelledRecording], groups: Collection[str]
) -> list[LabelledRecording]:
    known = {each.group for each in recordings} - {""}
    if missing := sorted({*groups} - known):
        there = ", ".join(sorted(known)) or "none"
        raise InputError(str(dataset), f"has no recordings of {', '.join(missing)}; its groups: {there}")
    return [each for each in recordings if not groups or each.group in groups]


def _turns(recordings: Sequence[LabelledRecording]) -> list[str]:
    """Return the fold of each recording: its own, or of several recordings if there are many."""
    if len(recordings) <= _MOST:
        return [each.name for each in recordings]
    return [f"part {place % _MOST + 1} of {_MOST}" for place in range(len(recordings))]

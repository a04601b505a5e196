"""Folds: which recordings detectors are judged on, and which they may learn from."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from flows.learn.labelled_recordings import LabelledRecording, by_split
from operators.batch import SLIP, STATIC
from operators.errors import InputError

EVERY: Final = "all"  # splits, or groups one after the other
_TURN: Final = 5  # every fifth session of a fold's training validates


@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """Recordings to judge detectors on, and others to fit them to."""

    name: str  # the group that is held out; empty: a split
    train: Sequence[LabelledRecording]
    validation: Sequence[LabelledRecording]  # to choose a checkpoint and a debounce
    judged: Sequence[LabelledRecording]


def split_fold(recordings: Sequence[LabelledRecording], split: str, source: str) -> Fold:
    """Return the fold that judges a split.

    Recordings that are judged, also under another name, take no part in the fitting.

    Args:
        recordings: All recordings of a dataset.
        split: One of the dataset's splits, or `EVERY`.
        source: Name of the dataset, for errors.

    Raises:
        InputError: if the split has no recordings, no slip or no static.
    """
    judged = [each for each in recordings if split in {each.split, EVERY}]
    if not judged:
        there = ", ".join(sorted({each.split for each in recordings} - {""})) or "none"
        raise InputError(source, f"has no split {split!r}; it has {there}; `--split all` takes everything")
    where = "to judge detectors on" if split == EVERY else f"in its {split} split; choose another split"
    _check_classes(judged, source, where)
    parts = by_split(_others(recordings, judged))
    return Fold("", parts["train"], parts["validation"], judged)


def group_folds(recordings: Sequence[LabelledRecording], groups: Collection[str], source: str) -> list[Fold]:
    """Return a fold for each group (surface or object) that is held out.

    Args:
        recordings: All recordings of a dataset.
        groups: Groups to hold out, one after the other; `EVERY`: all of them.
        source: Name of the dataset, for errors.

    Raises:
        InputError: if the dataset has fewer than two groups, lacks one of `groups`, or has no slip or static.
    """
    known = list(dict.fromkeys(each.group for each in recordings if each.group))
    there = ", ".join(sorted(known)) or "none"
    if len(known) < 2:
        reason = f"states fewer than two groups (surfaces or objects) of its recordings: {there}"
        raise InputError(source, f"{reason}; `group` in the `about` of a session states its group")
    if missing := sorted({*groups} - {*known, EVERY}):
        raise InputError(source, f"has no recordings of {', '.join(missing)}; its groups: {there}")
    _check_classes(recordings, source, "to hold out or to fit to")
    chosen = known if EVERY in groups else [each for each in known if each in groups]
    return [_group_fold(recordings, group) for group in chosen]


def _group_fold(recordings: Sequence[LabelledRecording], group: str) -> Fold:
    """Hold out a group; every fifth session of the others validates, those with slip counted first.

    If fewer than five have slip, all train and validate, as none can be spared.
    """
    judged = [each for each in recordings if each.group == group]
    others = _others(recordings, judged)
    slipping = {each.session for each in others if each.slip.any()}
    if len(slipping) < _TURN:
        return Fold(group, others, others, judged)
    others.sort(key=lambda each: each.session not in slipping)
    validating = {*[*dict.fromkeys(each.session for each in others)][_TURN // 2 :: _TURN]}
    train = [each for each in others if each.session not in validating]
    return Fold(group, train, [each for each in others if each.session in validating], judged)


def _others(
    recordings: Sequence[LabelledRecording], judged: Sequence[LabelledRecording]
) -> list[LabelledRecording]:
    """Return the recordings that are not judged, under any name."""
    known = {each.content for each in judged}
    return [each for each in recordings if each.content not in known]


def _check_classes(recordings: Sequence[LabelledRecording], source: str, where: str) -> None:
    for code, name in ((SLIP, "slip"), (STATIC, "static")):
        if not any((recording.label == code).any() for recording in recordings):
            raise InputError(source, f"has no {name} {where}")

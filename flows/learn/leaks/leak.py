"""Leaks: circumstances that make a score better than it will be on new data."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, Final, Literal, TypeAlias, cast

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.leaks.row_hashes import listed_hashes, occur, parse_hashes, shared_rows
from flows.report.table import counted
from operators import s
from operators.batch import Reals

LeakKind: TypeAlias = Literal[
    "shared rows", "neighbours", "known group", "trained on", "chosen on", "tuned on", "constant answer"
]

SEEN: Final = "seen"  # entry of a model card: the recordings that training used, by split
_NEIGHBOURS: Final = s  # ns, longest gap between two pieces of one recording: the longest window
_CONSTANT: Final = 0.995  # share of equal answers from which on a method counts as constant
_USES: Final[Mapping[str, tuple[LeakKind, str]]] = {
    "train": ("trained on", "was trained on"),
    "validation": ("chosen on", "had its checkpoint and its debounce chosen on"),
}


@dataclass(frozen=True, slots=True)
class Leak:
    """Circumstance that inflates a score."""

    kind: LeakKind
    method: str  # whose score it inflates; empty: every method that was fitted to the data
    finding: str  # one sentence

    def json(self) -> dict[str, str]:
        """Return the leak as JSON data."""
        return {"kind": self.kind, "method": self.method, "finding": self.finding}


def split_leaks(datasets: Iterable[Sequence[LabelledRecording]]) -> list[Leak]:
    """Return the leaks between the splits of datasets that are used together."""
    found = [list(each) for each in datasets]
    used = [each for each in chain.from_iterable(found) if each.split]
    shared = shared_leaks(used, [each.split for each in used])
    return [*shared, *_neighbours(found), *_known_groups(found)]


def shared_leaks(recordings: Sequence[LabelledRecording], parts: Sequence[str]) -> list[Leak]:
    """Return a leak if recordings of different parts, such as splits, share rows."""
    part = {id(each): own for each, own in zip(recordings, parts, strict=True)}
    pairs = [
        f"{each.first.name} ({part[id(each.first)]}) and {each.second.name} ({part[id(each.second)]}), "
        f"{counted(each.rows, 'row')}"
        for each in shared_rows(recordings, parts)
    ]
    if not pairs:
        return []
    text = f"{counted(len(pairs), 'pair')} of recordings in different splits share rows: {_some(pairs)}"
    return [Leak("shared rows", "", text)]


def seen_recordings(recordings: Iterable[LabelledRecording]) -> dict[str, Any]:
    """Return what a model card lists of the recordings that training uses: names, hashes and groups."""
    used = [each for each in recordings if each.split in _USES]
    return {
        split: {
            "groups": sorted({each.group for each in used if each.split == split} - {""}),
            "recordings": [[each.name, listed_hashes(each)] for each in used if each.split == split],
        }
        for split in _USES
    }


def card_leaks(
    method: str, card: Mapping[str, Any], judged: Sequence[LabelledRecording], digest: str = ""
) -> list[Leak]:
    """Return the leaks from judged recordings to a model, by its card.

    Args:
        method: Name of the method.
        card: Content of the model card; cards of earlier versions do not list recordings.
        judged: Recordings that the method is judged on.
        digest: sha256 of their dataset, which cards of all versions state.

    Raises:
        InputError: if the card is damaged.
    """
    if SEEN not in card:
        return _same_dataset(method, card, judged, digest)
    found = list[Leak]()
    for split, (kind, use) in _USES.items():
        about = cast("Mapping[str, Any]", card[SEEN].get(split, {}))
        names = [str(name) for name, _ in about.get("recordings", ())]
        listed = [parse_hashes(text, f"card of {method}") for _, text in about.get("recordings", ())]
        owners = np.repeat(np.arange(len(listed)), [len(each) for each in listed])
        hashes = np.concatenate([np.empty(0, np.uint64), *listed])
        pairs = [
            f"{each.name} ({names[owners[hit.argmax()]]} in training)"
            for each in judged
            if (hit := occur(hashes, each)).any()
        ]
        if pairs:
            text = f"{method} {use} {counted(len(pairs), 'judged recording')}: {_some(pairs)}"
            found.append(Leak(kind, method, text))
        groups = sorted({each.group for each in judged if each.group} & set(about.get("groups", ())))
        if groups and not pairs:
            found.append(Leak("known group", method, f"{method} {use} the judged {_some(groups)}"))
    return found


def lists_recordings(card: Mapping[str, Any]) -> bool:
    """Return True if a model card lists the recordings of its training."""
    return SEEN in card


def constant_leaks(method: str, counts: Reals) -> list[Leak]:
    """Return a leak if a method gives the same answer for nearly all samples.

    Args:
        method: Name of the method.
        counts: (2, 2) row: label static, slip; column: predicted static, slip.
    """
    shares = counts.sum(axis=0) / max(counts.sum(), 1)
    if shares.max() < _CONSTANT:
        return []
    answer = ("static", "slip")[int(shares.argmax())]
    right = 100 * counts[shares.argmax(), shares.argmax()] / counts.sum()
    how = "every sample" if shares.max() == 1 else f"{100 * shares.max():.1f} % of the samples"
    text = f"{method} answers {answer} for {how}: its accuracy is the share of {answer}, {right:.1f} %"
    return [Leak("constant answer", method, text)]


def overlapping(recordings: Sequence[LabelledRecording], judged: Sequence[LabelledRecording]) -> set[int]:
    """Return the places of the recordings that are judged or share rows with judged ones."""
    own = {id(each) for each in judged}
    others = [each for each in recordings if id(each) not in own]
    pairs = shared_rows([*others, *judged], [0] * len(others) + [1] * len(judged))
    bad = own | {id(each) for pair in pairs for each in (pair.first, pair.second)}
    return {place for place, each in enumerate(recordings) if id(each) in bad}


def _neighbours(datasets: Iterable[Sequence[LabelledRecording]]) -> list[Leak]:
    """Return a leak if a recording was cut into pieces that are in different splits."""
    pairs = list[str]()
    for recordings in datasets:
        ordered = sorted((each.span, n) for n, each in enumerate(recordings) if each.span and each.split)
        for ((_, end), one), ((start, _), other) in pairwise(ordered):
            first, second = recordings[one], recordings[other]
            if 0 <= start - end <= _NEIGHBOURS and first.split != second.split:
                pairs.append(f"{first.name} ({first.split}) and {second.name} ({second.split})")
    if not pairs:
        return []
    text = f"recordings of different splits continue each other: {_some(pairs)}"
    return [Leak("neighbours", "", text)]


def _known_groups(datasets: Iterable[Sequence[LabelledRecording]]) -> list[Leak]:
    everything = list(chain.from_iterable(datasets))
    known = {each.group for each in everything if each.split == "train"} - {""}
    groups = sorted(known & {each.group for each in everything if each.split == "test"})
    if not groups:
        return []
    text = (
        f"the train split has the test split's {_some(groups)}: scores are of known surfaces or objects; "
        "`slipflow benchmark` holds each out"
    )
    return [Leak("known group", "", text)]


def _same_dataset(
    method: str, card: Mapping[str, Any], judged: Sequence[LabelledRecording], digest: str
) -> list[Leak]:
    if not digest or digest not in {each.get("sha256") for each in card.get("data", ())}:
        return []
    found = list[Leak]()
    for split, (kind, use) in _USES.items():
        names = [each.name for each in judged if each.split == split]
        if names:
            text = f"{method} {use} {counted(len(names), 'judged recording')}: {_some(names)}"
            found.append(Leak(kind, method, text))
    return found


def _some(names: Sequence[str]) -> str:
    """Return the first names of a list."""
    shown = 3
    rest = len(names) - shown
    return ", ".join(names[:shown]) + (f" and {rest} more" if rest > 0 else "")

"""Hashes of the rows of recordings, which find copies, pieces and overlapping parts at any shift.

A hash covers the changes of all cells over 32 consecutive rows, so it does not depend on the baseline that
was subtracted. Stretches in which hardly anything changes are alike in unrelated recordings and have no hash.
A copy that was rescaled, filtered or resampled is not found.
"""

from base64 import b64decode, b64encode
from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flows.learn.labelled_recordings import LabelledRecording
from operators.errors import InputError

SPAN: Final = 32  # rows whose changes are hashed together
_MOVING: Final = 16  # least number of changed counts in a span
_LISTED: Final = 8  # hashes of a recording in a model card: the smallest
_BYTES: Final = 6  # of a listed hash

Hashes: TypeAlias = NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class SharedRows:
    """Rows that occur in two recordings."""

    first: LabelledRecording
    second: LabelledRecording
    rows: int


def row_hashes(recording: LabelledRecording) -> Hashes:
    """Return the different hashes of a recording's rows in increasing order; (k,)."""
    steps = np.diff(recording.counts.astype(np.int64), axis=0)  # (n - 1, cells)
    spans = len(steps) - SPAN + 1
    if spans < 1:
        return np.empty(0, np.uint64)
    random = np.random.default_rng(0)  # fixed: cards list hashes
    cells = random.integers(1, 2**63, steps.shape[1], np.uint64)
    rows = _mixed((steps.astype(np.uint64) * cells).sum(axis=1, dtype=np.uint64))  # (n - 1,)
    places = _mixed(np.arange(1, SPAN + 1, dtype=np.uint64)) | np.uint64(1)
    found = np.zeros(spans, np.uint64)
    for place, weight in enumerate(places):
        found += rows[place : place + spans] * weight
    moving = np.cumsum(np.concatenate([[0], np.count_nonzero(steps, axis=1)]))
    return np.unique(_mixed(found)[moving[SPAN:] - moving[:-SPAN] >= _MOVING])


def shared_rows(recordings: Sequence[LabelledRecording], parts: Sequence[Hashable]) -> list[SharedRows]:
    """Return the pairs of recordings of different parts that have rows in common, the most rows first.

    Args:
        recordings: Recordings.
        parts: Part of each recording, such as its split.
    """
    hashes = [row_hashes(each) for each in recordings]
    values = np.concatenate([np.empty(0, np.uint64), *hashes])
    owners = np.repeat(np.arange(len(hashes)), [len(each) for each in hashes])
    order = np.argsort(values, kind="stable")
    values, owners = values[order], owners[order]
    same = np.flatnonzero(values[1:] == values[:-1])
    pairs: Counter[tuple[int, int]] = Counter(
        zip(owners[same].tolist(), owners[same + 1].tolist(), strict=True)
    )
    found = [
        SharedRows(recordings[one], recordings[other], count + SPAN)
        for (one, other), count in pairs.items()
        if parts[one] != parts[other]
    ]
    return sorted(found, key=lambda shared: -shared.rows)


def listed_hashes(recording: LabelledRecording) -> str:
    """Return the hashes by which a model card names a recording, as text."""
    smallest = _short(row_hashes(recording)[:_LISTED])
    packed = smallest.astype(">u8").view(np.uint8).reshape(-1, 8)[:, 8 - _BYTES :]
    return b64encode(packed.tobytes()).decode()


def parse_hashes(text: object, where: str) -> Hashes:
    """Return the hashes that `listed_hashes` wrote; (k,).

    Raises:
        InputError: if the text is something else.
    """
    try:
        packed = np.frombuffer(b64decode(str(text), validate=True), np.uint8).reshape(-1, _BYTES)
    except ValueError as error:
        raise InputError(where, f"has an invalid list of hashes: {error}; restore a copy") from error
    padded = np.zeros((len(packed), 8), np.uint8)
    padded[:, 8 - _BYTES :] = packed
    return padded.reshape(-1).view(">u8").astype(np.uint64)


def occur(listed: Hashes, recording: LabelledRecording) -> NDArray[np.bool_]:
    """Return True for each listed hash (k,) that occurs in a recording."""
    return np.isin(listed, _short(row_hashes(recording)))


def _short(hashes: Hashes) -> Hashes:
    return hashes >> np.uint64(64 - 8 * _BYTES)


def _mixed(values: Hashes) -> Hashes:
    """Return well-distributed 64-bit values (splitmix64)."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))

"""Samples of a session on a regular time grid, for robot-learning datasets; no value is interpolated.

Each sample goes to its nearest grid point, so it is used at most once. Of two samples for one point the
nearer is kept. A grid point becomes a frame if every fingertip has a sample there and the requested motion
data is known. A missing frame splits the session: the frames of one `Frames` are consecutive.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import EVERY, Codes, Counts, Flags, Labelled, Motion, Times, ms, s
from operators.errors import InputError
from operators.score import forward_fill
from storage.session import Session

WITHIN: Final = 20 * ms  # ns, largest distance between a sample and its pose

Singles = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Consecutive frames at a fixed rate."""

    time: Times  # (n,) ns, recorded time of the first fingertip's samples
    counts: Counts  # (n, fingers * cells) zeroed; a cell without a reading keeps its last value
    valid: Flags  # (n, fingers * cells) False: no reading
    label: Codes  # (n, fingers) 1 slip, 0 static, -1 unknown
    velocity: Singles  # (n, 6) m/s, rad/s, of the TCP; NaN if not requested
    pose: Singles  # (n, 6) m, rad; NaN if not requested

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: NDArray[np.intp]) -> "Frames":
        return Frames(
            self.time[rows],
            self.counts[rows],
            self.valid[rows],
            self.label[rows],
            self.velocity[rows],
            self.pose[rows],
        )


@dataclass(frozen=True, slots=True)
class Contents:
    """Data of a session that frames can have."""

    fingers: tuple[int, ...]
    cells: int  # of each fingertip
    velocity: bool
    pose: bool


@dataclass(frozen=True, slots=True)
class GridSession:
    """Frames of a session, split at gaps."""

    stretches: tuple[Frames, ...]
    samples: int  # of the first fingertip


def find_contents(session: Session) -> Contents:
    """Return the fingertips and the motion data of a session.

    Raises:
        InputError: if the session has no samples, or is damaged.
    """
    fingers = session.fingers(Labelled)
    if not fingers:
        reason = "has no samples, which frames are made of: record with `slipflow run record`"
        raise InputError(str(session.folder), reason)
    samples = [*session.read(Labelled, fingers[0])]
    velocity = any(bool(np.isfinite(batch.velocity).all(axis=1).any()) for batch in samples)
    motion = chain.from_iterable(session.read(Motion, finger) for finger in session.fingers(Motion))
    pose = any(bool(np.isfinite(batch.pose).all(axis=1).any()) for batch in motion)
    return Contents(fingers, samples[0].cells, velocity, pose)


def to_frames(session: Session, rate: int, wanted: Contents) -> GridSession:
    """Return the frames of a session at `rate` Hz; isolated frames are omitted.

    The grid starts at the mean time of the fingertips' first samples.

    Raises:
        InputError: if the session is damaged.
    """
    fingers = [_samples(session, finger) for finger in wanted.fingers]
    motion = _motion(session) if wanted.pose else None
    begin = sum(int(each.time[0]) for each in fingers) // len(fingers)
    near = [_nearest(each.time - begin, rate) for each in fingers]
    ticks = near[0].ticks
    for other in near[1:]:
        ticks = np.intersect1d(ticks, other.ticks, assume_unique=True)
    joined = _join(fingers, [each.rows[np.searchsorted(each.ticks, ticks)] for each in near], motion)
    known = np.ones(len(ticks), np.bool_)
    if wanted.velocity:
        known &= np.isfinite(joined.velocity).all(axis=1)
    if wanted.pose:
        known &= np.isfinite(joined.pose).all(axis=1)
    kept = np.flatnonzero(known)
    cuts = np.flatnonzero(np.diff(ticks[kept]) != 1) + 1
    stretches = [joined[rows] for rows in np.split(kept, cuts) if len(rows) > 1]
    return GridSession(tuple(stretches), len(fingers[0].time))


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Samples of one fingertip in time order."""

    time: Times  # (n,)
    counts: Counts  # (n, cells)
    valid: Flags  # (n, cells)
    label: Codes  # (n,)
    velocity: Singles  # (n, 6)


@dataclass(frozen=True, slots=True, eq=False)
class _GridRows:
    """Nearest samples to grid points."""

    ticks: NDArray[np.int64]  # (n,) grid points, ascending
    rows: NDArray[np.intp]  # (n,) rows of the samples


def _samples(session: Session, finger: int) -> _Samples:
    pieces = [
        (batch.time, batch.counts, batch.valid, batch.label, batch.velocity.astype(np.float32))
        for batch in session.read(Labelled, finger)
    ]
    time, counts, valid, label, velocity = (np.concatenate(column) for column in zip(*pieces, strict=True))
    order = np.argsort(time, kind="stable")
    filled = forward_fill(counts[order], valid[order])
    label, _ = session.hand_labels().replace(label, time, finger)
    return _Samples(time[order], filled, valid[order], label[order], velocity[order])


def _motion(session: Session) -> tuple[Times, Singles]:
    """Return times (n,) and poses (n, 6) of the arm; rows without a pose are omitted."""
    times, poses = list[Times](), list[Singles]()
    for batch in session.read(Motion, EVERY):
        finite = np.all(np.isfinite(batch.pose), axis=1)
        times.append(batch.time[finite])
        poses.append(batch.pose[finite].astype(np.float32))
    time, pose = np.concatenate(times), np.concatenate(poses)
    order = np.argsort(time, kind="stable")
    return time[order], pose[order]


def _nearest(since: Times, rate: int) -> _GridRows:
    """Return the nearest sample to each grid point, for samples at `since` ns after the grid's begin."""
    seconds, rest = np.divmod(since, s)  # separately, as since * rate can exceed 64 bits
    ticks, distance = np.divmod(2 * rest * rate + s, 2 * s)  # (n,) nearest grid point within the second
    ticks, distance = ticks + seconds * rate, np.abs(distance - s)
    order = np.lexsort((distance, ticks))
    first = np.flatnonzero(np.diff(ticks[order], prepend=ticks[order[0]] - 1))
    return _GridRows(ticks[order[first]], order[first])


def _join(
    fingers: Sequence[_Samples], rows: Sequence[NDArray[np.intp]], motion: tuple[Times, Singles] | None
) -> Frames:
    """Return the chosen rows of all fingertips as frames."""
    first, chosen = fingers[0], rows[0]
    time = first.time[chosen]
    return Frames(
        time,
        np.concatenate([each.counts[row] for each, row in zip(fingers, rows, strict=True)], axis=1),
        np.concatenate([each.valid[row] for each, row in zip(fingers, rows, strict=True)], axis=1),
        np.stack([each.label[row] for each, row in zip(fingers, rows, strict=True)], axis=1),
        first.velocity[chosen],
        np.full((len(time), 6), np.nan, np.float32) if motion is None else _poses(time, *motion),
    )


def _poses(time: Times, known: Times, pose: Singles) -> Singles:
    """Return the nearest pose (n, 6) to each time; NaN if none is within `WITHIN`."""
    after = known.searchsorted(time).clip(0, len(known) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(time - known[before] < known[after] - time, before, after)
    near = np.abs(known[nearest] - time) <= WITHIN
    return np.where(near[:, None], pose[nearest], np.float32(np.nan))

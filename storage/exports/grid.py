"""A session on a regular grid of time, as robot-learning datasets have it; no value is made up.

A sample belongs to the instant of the grid that it is nearest to, so it is never used twice; of two for one
instant the nearer is kept. An instant is a frame if every fingertip has a sample there and what is asked for
of the arm is known. Where one is missing the frames are cut: those of one `Frames` follow each other without
a gap.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, EVERY, Codes, Counts, Flags, Labelled, Motion, Times, ms, s
from operators.errors import InputError
from operators.forward_fill import forward_fill
from storage.session import Session

WITHIN: Final = 20 * ms  # ns, that a pose may lie from its sample

Singles = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Frames that follow each other at a fixed rate."""

    time: Times  # (n,) ns, of the first fingertip's samples, as recorded
    counts: Counts  # (n, fingers * 6) zeroed; a cell that did not answer reads what it read last
    valid: Flags  # (n, fingers * 6) False where it did not answer
    label: Codes  # (n, fingers) 1 slip, 0 static, -1 unknown
    velocity: Singles  # (n, 6) m/s, rad/s, of the TCP; NaN only if it was not asked for
    pose: Singles  # (n, 6) m, rad; NaN only if it was not asked for

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
class Holdings:
    """What of a session can become frames."""

    fingers: tuple[int, ...]
    velocity: bool
    pose: bool


@dataclass(frozen=True, slots=True)
class Cut:
    """A session in stretches without a gap."""

    stretches: tuple[Frames, ...]
    samples: int  # of the first fingertip, that there were


def holdings(session: Session) -> Holdings:
    """What a session holds.

    Raises:
        InputError: if it holds no samples, or is damaged.
    """
    fingers = session.fingers(Labelled)
    if not fingers:
        reason = "holds no samples, which frames are made of; `slipflow run record` makes some"
        raise InputError(str(session.folder), reason)
    samples = session.read(Labelled, fingers[0])
    velocity = any(bool(np.isfinite(batch.velocity).all(axis=1).any()) for batch in samples)
    motion = chain.from_iterable(session.read(Motion, finger) for finger in session.fingers(Motion))
    pose = any(bool(np.isfinite(batch.pose).all(axis=1).any()) for batch in motion)
    return Holdings(fingers, velocity, pose)


def frames(session: Session, rate: int, wanted: Holdings) -> Cut:
    """The frames of a session at `rate` Hz; one that stands alone is none.

    The grid begins where the first samples of the fingertips lie on average.

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
    whole = _joined(fingers, [each.rows[np.searchsorted(each.ticks, ticks)] for each in near], motion)
    known = np.ones(len(ticks), np.bool_)
    if wanted.velocity:
        known &= np.isfinite(whole.velocity).all(axis=1)
    if wanted.pose:
        known &= np.isfinite(whole.pose).all(axis=1)
    kept = np.flatnonzero(known)
    cuts = np.flatnonzero(np.diff(ticks[kept]) != 1) + 1
    stretches = [whole[rows] for rows in np.split(kept, cuts) if len(rows) > 1]
    return Cut(tuple(stretches), len(fingers[0].time))


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """What is needed of one fingertip's samples, in the order of time."""

    time: Times  # (n,)
    counts: Counts  # (n, 6)
    valid: Flags  # (n, 6)
    label: Codes  # (n,)
    velocity: Singles  # (n, 6)


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """Which sample stands for which instant of the grid."""

    ticks: NDArray[np.int64]  # (n,) numbers of the instants, ascending
    rows: NDArray[np.intp]  # (n,)


def _samples(session: Session, finger: int) -> _Samples:
    pieces = [
        (batch.time, batch.counts, batch.valid, batch.label, batch.velocity.astype(np.float32))
        for batch in session.read(Labelled, finger)
    ]
    time, counts, valid, label, velocity = (np.concatenate(column) for column in zip(*pieces, strict=True))
    order = np.argsort(time, kind="stable")
    held = forward_fill(counts[order], valid[order], np.zeros(BAROMETERS, np.int16))
    return _Samples(time[order], held, valid[order], label[order], velocity[order])


def _motion(session: Session) -> tuple[Times, Singles]:
    """When the arm told its pose, and the pose; (n,), (n, 6)."""
    times, poses = list[Times](), list[Singles]()
    for batch in session.read(Motion, EVERY):
        finite = np.all(np.isfinite(batch.pose), axis=1)
        times.append(batch.time[finite])
        poses.append(batch.pose[finite].astype(np.float32))
    time, pose = np.concatenate(times), np.concatenate(poses)
    order = np.argsort(time, kind="stable")
    return time[order], pose[order]


def _nearest(since: Times, rate: int) -> _Near:
    """Which samples stand for which instants, of those taken `since` the begin of the grid (ns)."""
    ticks = (2 * since * rate + s) // (2 * s)  # (n,) the nearest instant
    distance = np.abs(since - ticks * s // rate)
    order = np.lexsort((distance, ticks))
    first = np.flatnonzero(np.diff(ticks[order], prepend=ticks[order[0]] - 1))
    return _Near(ticks[order[first]], order[first])


def _joined(
    fingers: Sequence[_Samples], rows: Sequence[NDArray[np.intp]], motion: tuple[Times, Singles] | None
) -> Frames:
    """The samples that were chosen of each fingertip, side by side."""
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


def _poses(time: Times, told: Times, pose: Singles) -> Singles:
    """The nearest pose to each instant, NaN where none is near enough; (n, 6)."""
    after = told.searchsorted(time).clip(0, len(told) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(time - told[before] < told[after] - time, before, after)
    near = np.abs(told[nearest] - time) <= WITHIN
    return np.where(near[:, None], pose[nearest], np.float32(np.nan))

"""A session that is written step by step, and all that can be read of one."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from operators import EVERY, Batch, Labelled, Motion, Slips, Touch, concat, ms, s
from operators.ports import Json, Run
from storage import Session
from storage.writer import SessionWriter
from tests.chaos.numbered import alike, motion, touch

NAME = "one"
START = 1_700_000_000 * s  # ns
STREAMS: tuple[tuple[type[Batch], int], ...] = ((Touch, 0), (Motion, EVERY), (Labelled, 0), (Slips, 0))
RETOLD = ("complete", "recovered", "error", "end", "end_ns", "zeroed")  # of session.json, by a recovery


class Still:
    """A clock that stands."""

    def now(self) -> int:
        """A minute after the start."""
        return START + 60 * s

    async def sleep_until(self, time: int) -> None:
        """Never."""
        raise AssertionError(time)


def row(kind: type[Batch], number: int) -> Batch:
    """The row of a table that has this number."""
    numbers, time = np.array([number]), np.array([START + number * 10 * ms])
    if kind is Touch:
        return touch(numbers, time)
    if kind is Motion:
        return motion(numbers, time)
    if kind is Slips:
        return Slips(time, np.array([number % 2], np.int8), time, np.array([number / 1000]), finger=0)
    felt, moved = touch(numbers, time), motion(numbers, time)
    unknown = np.full(felt.counts.shape, -1, np.int16)  # as what samples do not keep is read again
    return Labelled(
        time,
        felt.counts,
        unknown,
        felt.valid,
        moved.velocity,
        np.full(moved.pose.shape, np.nan),
        np.array([True]),
        np.array([number / 512]),
        np.array([number % 3 - 1], np.int8),
        finger=0,
    )


def begin(root: Path, *, part_rows: int = 1000, live: bool = True) -> SessionWriter:
    """A session, to which nobody else writes."""
    about: dict[str, Json] = {"sensor": "made of numbers", "rate_hz": 100}
    run = Run(NAME, "chaos", Still(), START, live=live, describe={"touch": about})
    return SessionWriter(root, run, part_span=1000 * s, part_rows=part_rows)


def write(writer: SessionWriter, number: int) -> None:
    """One row of each stream, which is in the journal then, if there is one."""
    for kind, _ in STREAMS:
        batch = row(kind, number)
        while writer.full(batch):
            writer.commit()
        if writer.journalled:
            writer.append(batch)
        else:
            writer.add(batch)


@dataclass(frozen=True)
class Contents:
    """All that a session gives."""

    rows: tuple[Batch, ...]  # by stream
    about: Mapping[str, Any]  # what it says of itself

    @property
    def lost(self) -> bool:
        """Whether it says that rows are lost."""
        return bool(self.about.get("recovered", {}).get("lost"))

    def same(self, other: "Contents") -> bool:
        """Whether rows and words are the same, whatever a recovery said of itself."""
        return self.first_of(other) and all(map(_as_long, self.rows, other.rows))

    def first_of(self, other: "Contents") -> bool:
        """Whether each stream has the first rows of the other's, and all else that is said is the same."""
        mine, theirs = ({k: v for k, v in each.about.items() if k not in RETOLD} for each in (self, other))
        pairs = zip(self.rows, other.rows, strict=True)
        return mine == theirs and all(not len(a) or alike(a, b[: len(a)]) for a, b in pairs)


def _as_long(left: Batch, right: Batch) -> bool:
    return len(left) == len(right)


def read(folder: Path) -> Contents:
    """Read all of a session, which is put right first where that is needed.

    Raises:
        SlipflowError: if it cannot be had.
    """
    session = Session.open(folder)
    rows = tuple(concat(kind, list(session.read(kind, finger))) for kind, finger in STREAMS)
    return Contents(rows, session.describe())

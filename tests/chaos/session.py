"""Session that is written row by row, and what can be read from it."""

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
CHANGED_BY_RECOVERY = (
    "complete",
    "recovered",
    "error",
    "end",
    "end_ns",
    "zeroed",
)  # keys of session.json that a recovery changes


class FixedClock:
    """Clock that does not advance."""

    def now(self) -> int:
        """Return the time, ns: a minute after the start."""
        return START + 60 * s

    async def sleep_until(self, time: int) -> None:
        """Fail: nothing waits."""
        raise AssertionError(time)


def row(kind: type[Batch], number: int) -> Batch:
    """Return the row of a table with this number."""
    numbers, time = np.array([number]), np.array([START + number * 10 * ms])
    if kind is Touch:
        return touch(numbers, time)
    if kind is Motion:
        return motion(numbers, time)
    if kind is Slips:
        return Slips(time, np.array([number % 2], np.int8), time, np.array([number / 1000]), finger=0)
    touch_row, motion_row = touch(numbers, time), motion(numbers, time)
    unknown = np.full(touch_row.counts.shape, -1, np.int16)  # samples do not store it
    return Labelled(
        time,
        touch_row.counts,
        unknown,
        touch_row.valid,
        motion_row.velocity,
        np.full(motion_row.pose.shape, np.nan),
        np.array([True]),
        np.array([number / 512]),
        np.array([number % 3 - 1], np.int8),
        finger=0,
    )


def begin(root: Path, *, part_rows: int = 1000, live: bool = True) -> SessionWriter:
    """Begin a session."""
    about: dict[str, Json] = {"sensor": "test pattern", "rate_hz": 100}
    run = Run(NAME, "chaos", FixedClock(), START, live=live, describe={"touch": about})
    return SessionWriter(root, run, part_span=1000 * s, part_rows=part_rows)


def write(writer: SessionWriter, number: int) -> None:
    """Write one row of each stream, to the journal if there is one."""
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
    """Content of a session."""

    rows: tuple[Batch, ...]  # by stream
    about: Mapping[str, Any]  # session.json

    @property
    def lost(self) -> bool:
        """True if the session reports lost rows."""
        return bool(self.about.get("recovered", {}).get("lost"))

    def same(self, other: "Contents") -> bool:
        """Return True if rows and description are equal, except for what a recovery changes."""
        return self.first_of(other) and all(map(_same_length, self.rows, other.rows))

    def first_of(self, other: "Contents") -> bool:
        """Return True if each stream has the first rows of the other, and the descriptions are equal."""
        mine, theirs = (
            {k: v for k, v in each.about.items() if k not in CHANGED_BY_RECOVERY} for each in (self, other)
        )
        pairs = zip(self.rows, other.rows, strict=True)
        return mine == theirs and all(not len(a) or alike(a, b[: len(a)]) for a, b in pairs)


def _same_length(left: Batch, right: Batch) -> bool:
    return len(left) == len(right)


def read(folder: Path) -> Contents:
    """Read a session, which is recovered first if necessary.

    Raises:
        SlipflowError: if it cannot be read.
    """
    session = Session.open(folder)
    rows = tuple(concat(kind, list(session.read(kind, finger))) for kind, finger in STREAMS)
    return Contents(rows, session.describe())

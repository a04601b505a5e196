"""A recorder in a process of its own, which counts its rows where no kill can take the count back.

    python -m tests.chaos.record FOLDER COUNTS RATE

COUNTS is a file of five 64-bit numbers: rows of touch and of motion that were given, and rows of touch,
motion and samples that the dataset took. Touch has RATE rows a second, motion a quarter more. Runs until it
is killed.
"""

import asyncio
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flows.graph import Flow
from flows.run.live_runner import LiveRunner
from operators import (
    EVERY,
    Align,
    Batch,
    Label,
    Labelled,
    Motion,
    Sink,
    Touch,
    Zero,
    ms,
    s,
)
from storage import Dataset
from storage.dataset import Recordable
from tests.chaos.numbered import Numbered, motion, touch

SESSION = "killed"
GIVEN, TAKEN = slice(0, 2), slice(2, 5)  # of the counts
PART = s // 2  # of event time: within a short life there are commits
KINDS: tuple[type[Batch], ...] = (Touch, Motion, Labelled)
FASTER = 1.25  # than the touch is the motion


class Counted(Dataset):
    """Counts what it took."""

    def __init__(self, path: Path, counts: NDArray[np.int64]) -> None:
        super().__init__(path, part_span=PART)
        self._taken = counts[TAKEN]

    def take(self, batch: Recordable) -> bool:
        """Take one batch, and count it."""
        taken = super().take(batch)
        if taken:
            self._taken[KINDS.index(type(batch))] += len(batch)
        return taken

    async def write(self, batch: Recordable) -> None:
        """Write one batch, and count it."""
        column = KINDS.index(type(batch))
        before = self._taken[column]
        await super().write(batch)
        self._taken[column] = before + len(batch)  # also if it went to the journal without `take`


def declared(sink: Sink[Touch | Motion | Labelled], rate: float, given: NDArray[np.int64]) -> Flow:
    """Two streams, and the samples labelled from them."""

    def count(stream: int, rows: int) -> None:
        given[stream] = rows

    flow = Flow("killed")
    touched = flow.source(Numbered(Touch, touch, rate, lambda rows: count(0, rows)), "touch")
    moved = flow.source(
        Numbered(Motion, motion, FASTER * rate, lambda rows: count(1, rows), (EVERY,)), "motion"
    )
    touched.to(sink)
    moved.to(sink)
    ((touched | Zero(500)) & moved | Align(within=20 * ms) | Label(speed=0.003)).to(sink)
    return flow


async def main() -> None:
    """Record until killed."""
    folder, place, rate = sys.argv[1:]
    counts: NDArray[np.int64] = np.memmap(place, np.int64, "r+")
    sink = Counted(Path(folder), counts)
    await LiveRunner(declared(sink, float(rate), counts[GIVEN]), SESSION).execute()


if __name__ == "__main__":
    asyncio.run(main())

"""Recorder whose row counts survive a kill, as a process.

    python -m tests.chaos.record FOLDER COUNTS RATE

COUNTS is a file of five 64-bit numbers: rows of touch and motion that were produced, and rows of touch,
motion and samples that the dataset accepted. Touch has RATE rows per second, motion a quarter more. Runs
until killed.
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
PRODUCED, ACCEPTED = slice(0, 2), slice(2, 5)  # of the counts
PART = s // 2  # ns of event time; short, so that parts are committed
KINDS: tuple[type[Batch], ...] = (Touch, Motion, Labelled)
MOTION_FACTOR = 1.25  # rows of motion per row of touch


class Counted(Dataset):
    """Dataset that counts the rows it accepted."""

    def __init__(self, path: Path, counts: NDArray[np.int64]) -> None:
        super().__init__(path, part_span=PART)
        self._accepted = counts[ACCEPTED]

    def take(self, batch: Recordable) -> bool:
        """Take one batch and count it."""
        accepted = super().take(batch)
        if accepted:
            self._accepted[KINDS.index(type(batch))] += len(batch)
        return accepted

    async def write(self, batch: Recordable) -> None:
        """Write one batch and count it."""
        column = KINDS.index(type(batch))
        before = self._accepted[column]
        await super().write(batch)
        self._accepted[column] = before + len(batch)  # `write` does not always call `take`


def declare(sink: Sink[Touch | Motion | Labelled], rate: float, produced: NDArray[np.int64]) -> Flow:
    """Declare two streams, and samples labelled from them."""

    def count(stream: int, rows: int) -> None:
        produced[stream] = rows

    flow = Flow("killed")
    touch_stream = flow.source(Numbered(Touch, touch, rate, lambda rows: count(0, rows)), "touch")
    motion_stream = flow.source(
        Numbered(Motion, motion, MOTION_FACTOR * rate, lambda rows: count(1, rows), (EVERY,)), "motion"
    )
    touch_stream.to(sink)
    motion_stream.to(sink)
    ((touch_stream | Zero(500)) & motion_stream | Align(within=20 * ms) | Label(speed=0.003)).to(sink)
    return flow


async def main() -> None:
    """Record until killed."""
    folder, counts_file, rate = sys.argv[1:]
    counts: NDArray[np.int64] = np.memmap(counts_file, np.int64, "r+")
    sink = Counted(Path(folder), counts)
    await LiveRunner(declare(sink, float(rate), counts[PRODUCED]), SESSION).execute()


if __name__ == "__main__":
    asyncio.run(main())

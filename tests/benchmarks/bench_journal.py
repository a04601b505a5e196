"""CPU of a live recording with and without a journal, and what a power cut costs; run by `make bench`.

Three fingertips at 100 Hz, an arm at 500 Hz, one row at a time. CPU is that of the process, in % of one core.
A power cut costs the rows written since the start of the last fsync that had ended.
"""

import asyncio
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import numpy as np

from operators import EVERY, Batch, Motion, Run, Touch, ms, s
from storage import Dataset, dataset, files

SECONDS = 20.0
FINGERS = 3


class Clock:
    """Time of the host."""

    def now(self) -> int:
        """Return ns since 1970."""
        return time.time_ns()

    async def sleep_until(self, time: int) -> None:
        """Not used."""
        raise AssertionError(time)


def batches(number: int) -> list[Batch]:
    """Return the rows of 2 ms."""
    now = np.array([time.time_ns()])
    six = np.zeros((1, 6))
    found: list[Batch] = [Motion(now, now, six, six, finger=EVERY)]
    if number % 5 == 0:
        counts = six.astype(np.int16)
        found += [Touch(now, counts, counts, six == 0, finger=finger) for finger in range(FINGERS)]
    return found


async def record(root: Path, *, live: bool) -> tuple[float, float]:
    """Return CPU (% of a core) and the longest time (s) between a row and the fsync that makes it durable."""
    syncs, fsync = list[tuple[float, float]](), files.fsync

    def timed(file: int) -> None:
        began = time.monotonic()
        fsync(file)
        syncs.append((began, time.monotonic()))

    sink, number = Dataset(root, part_span=30 * s), 0
    with patch.object(files, "fsync", timed):
        await sink.open(Run("one", "bench", Clock(), time.time_ns(), live=live))
        began, cpu = time.monotonic(), time.process_time()
        while (now := time.monotonic()) - began < SECONDS:
            while number * 2 * ms < (now - began) * s:
                for batch in batches(number):
                    await sink.write(batch)  # type: ignore[arg-type]
                number += 1
            await asyncio.sleep(0.002)
        spent, ended = time.process_time() - cpu, time.monotonic()
        await sink.close()
    during = [pair for pair in syncs if began < pair[0] < ended]
    gaps = [later[1] - earlier[0] for earlier, later in pairwise(during)]
    return 100 * spent / (ended - began), max(gaps, default=float("nan"))


def main() -> None:
    """Print one line for each way."""
    for live, interval in ((False, dataset.SYNC_INTERVAL), (True, 1.0), (True, dataset.SYNC_INTERVAL)):
        with tempfile.TemporaryDirectory() as folder, patch.object(dataset, "SYNC_INTERVAL", interval):
            cpu, longest = asyncio.run(record(Path(folder) / "data", live=live))
        what = f"journal, fsync {interval:g} s after the last" if live else "no journal"
        sys.stdout.write(
            f"{what:34} {cpu:5.1f} % of a core, power cut: {longest + dataset.APPEND_INTERVAL:.2f} s\n"
        )


if __name__ == "__main__":
    main()

"""Plain asyncio, live: a task for each operator, a queue before each task."""

import asyncio
from time import perf_counter_ns
from typing import Any

from tests.benchmarks.peers.live import Live, carry_out_live
from tests.benchmarks.peers.records import Energy, zeroed

Queue = asyncio.Queue[Any]  # of tuples; None: the stream has ended


async def feed(live: Live, target: Queue) -> None:
    """Each sample when it is due."""
    live.begin()
    for finger, due, counts in live.records:
        if (wait := live.wait(due)) > 0:
            await asyncio.sleep(wait)
        await target.put((finger, perf_counter_ns(), counts))
    await target.put(None)


async def zero(source: Queue, target: Queue) -> None:
    """Counts relative to the unloaded fingertip."""
    while (record := await source.get()) is not None:
        finger, stamp, counts = record
        await target.put((finger, stamp, zeroed(counts)))
    await target.put(None)


async def score(source: Queue, target: Queue, fingers: int) -> None:
    """What the window says."""
    energies = {finger: Energy() for finger in range(fingers)}
    while (record := await source.get()) is not None:
        finger, stamp, counts = record
        value = energies[finger].score(counts)
        if value is not None:
            await target.put((finger, stamp, value))
    await target.put(None)


async def take(live: Live, source: Queue) -> None:
    """The sink."""
    while (event := await source.get()) is not None:
        live.told(*event)


async def carry(live: Live) -> None:
    """All of it."""
    first, second, last = (Queue(1000) for _ in range(3))
    fingers = len(live.job.time)
    await asyncio.gather(
        feed(live, first), zero(first, second), score(second, last, fingers), take(live, last)
    )


def run(live: Live, _: str) -> None:
    """To the last event."""
    asyncio.run(carry(live))


if __name__ == "__main__":
    carry_out_live(run)

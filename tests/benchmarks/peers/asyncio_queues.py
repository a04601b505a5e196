"""Plain asyncio: a task for each operator, a queue before each task, a record at a time."""

import asyncio
from collections.abc import Iterable
from typing import Any

from tests.benchmarks.peers.job import MOTION, Job, Judged, Meter, Record, Run, carry_out
from tests.benchmarks.peers.records import Energy, Newest, label, zeroed

CAPACITY = 1000  # items of a queue
Queue = asyncio.Queue[Any]  # of tuples; None: the stream has ended


async def zero(source: Queue, target: Queue) -> None:
    """Counts relative to the unloaded fingertip; motion goes past."""
    while (record := await source.get()) is not None:
        finger, time, values = record
        await target.put(record if finger == MOTION else (finger, time, zeroed(values)))
    await target.put(None)


async def align(source: Queue, target: Queue) -> None:
    """The motion of each touch."""
    newest = Newest()
    while (record := await source.get()) is not None:
        finger, time, values = record
        if finger == MOTION:
            newest.take(time, values)
        else:
            await target.put((finger, values, newest.at(time)))
    await target.put(None)


async def labelled(source: Queue, target: Queue) -> None:
    """What the motion says."""
    while (record := await source.get()) is not None:
        finger, counts, velocity = record
        await target.put((finger, counts, label(velocity)))
    await target.put(None)


async def score(source: Queue, target: Queue, fingers: int) -> None:
    """What the window says."""
    energies = {finger: Energy() for finger in range(fingers)}
    while (record := await source.get()) is not None:
        finger, counts, known = record
        value = energies[finger].score(counts)
        if value is not None:
            await target.put((finger, known, value))
    await target.put(None)


async def carry(records: list[Record], fingers: int) -> list[Judged]:
    """All of them, to the end."""
    first, second, third, fourth, last = (Queue(CAPACITY) for _ in range(5))
    out: list[Judged] = []

    async def feed() -> None:
        for record in records:
            await first.put(record)
        await first.put(None)

    async def take() -> None:
        while (judged := await last.get()) is not None:
            out.append(judged)

    await asyncio.gather(
        feed(),
        zero(first, second),
        align(second, third),
        labelled(third, fourth),
        score(fourth, last, fingers),
        take(),
    )
    return out


def prepare(job: Job, _: int) -> Run:
    """Each record by itself."""
    records = job.records()

    def run(meter: Meter) -> Iterable[Judged]:
        with meter:
            return asyncio.run(carry(records, len(job.time)))

    return run


if __name__ == "__main__":
    carry_out(prepare)

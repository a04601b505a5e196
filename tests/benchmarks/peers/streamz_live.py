"""streamz, live: a pipeline on an asyncio loop, into which each sample is emitted."""

import asyncio
from time import perf_counter_ns

from streamz import Stream

from tests.benchmarks.peers.live import Live, carry_out_live
from tests.benchmarks.peers.records import Energy, zeroed


def zero(record):
    """Counts relative to the unloaded fingertip."""
    finger, stamp, counts = record
    return finger, stamp, zeroed(counts)


def score(energies, record):
    """What the window says; None before the first one is complete."""
    finger, stamp, counts = record
    value = energies[finger].score(counts)
    return energies, None if value is None else (finger, stamp, value)


def given(record) -> bool:
    """Whether there is something."""
    return record is not None


async def carry(live: Live) -> None:
    """All of it."""
    source = Stream(asynchronous=True)
    energies = [Energy() for _ in live.job.time]
    scored = source.map(zero).accumulate(score, start=energies, returns_state=True).filter(given)
    scored.sink(lambda event: live.told(*event) and None)
    live.begin()
    for finger, due, counts in live.records:
        if (wait := live.wait(due)) > 0:
            await asyncio.sleep(wait)
        await source.emit((finger, perf_counter_ns(), counts))


def run(live: Live, _: str) -> None:
    """To the last event."""
    asyncio.run(carry(live))


if __name__ == "__main__":
    carry_out_live(run)

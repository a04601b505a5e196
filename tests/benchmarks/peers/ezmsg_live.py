"""ezmsg, live: a unit for each operator in one process; a message is a sample."""

import asyncio
from collections.abc import AsyncGenerator
from itertools import pairwise
from time import perf_counter_ns

import ezmsg.core as ez

from tests.benchmarks.peers.live import Live, carry_out_live
from tests.benchmarks.peers.records import Energy, zeroed


class Shared(ez.Unit):
    """What all units have in common."""

    live: Live


class Source(Shared):
    """Hands each sample over when it is due."""

    OUTPUT = ez.OutputStream(object)

    @ez.publisher(OUTPUT)
    async def give(self) -> AsyncGenerator:
        """All of them."""
        self.live.begin()
        for finger, due, counts in self.live.records:
            if (wait := self.live.wait(due)) > 0:
                await asyncio.sleep(wait)
            yield self.OUTPUT, (finger, perf_counter_ns(), counts)


class Zero(Shared):
    """Counts relative to the unloaded fingertip."""

    INPUT = ez.InputStream(object)
    OUTPUT = ez.OutputStream(object)

    @ez.subscriber(INPUT)
    @ez.publisher(OUTPUT)
    async def take(self, record) -> AsyncGenerator:
        """Give the same, zeroed."""
        finger, stamp, counts = record
        yield self.OUTPUT, (finger, stamp, zeroed(counts))


class Score(Shared):
    """What the window says."""

    INPUT = ez.InputStream(object)
    OUTPUT = ez.OutputStream(object)

    async def initialize(self) -> None:
        """Begin with empty windows."""
        self.energies = [Energy() for _ in self.live.job.time]

    @ez.subscriber(INPUT)
    @ez.publisher(OUTPUT)
    async def take(self, record) -> AsyncGenerator:
        """Give what is complete."""
        finger, stamp, counts = record
        value = self.energies[finger].score(counts)
        if value is not None:
            yield self.OUTPUT, (finger, stamp, value)


class Sink(Shared):
    """Takes the events."""

    INPUT = ez.InputStream(object)

    @ez.subscriber(INPUT)
    async def take(self, event) -> None:
        """Take; the last one ends the run."""
        if self.live.told(*event):
            raise ez.NormalTermination


def run(live: Live, _: str) -> None:
    """To the last event."""
    chain = [kind() for kind in (Source, Zero, Score, Sink)]
    for unit in chain:
        unit.live = live
    ez.run(
        components={type(unit).__name__: unit for unit in chain},
        connections=[(first.OUTPUT, second.INPUT) for first, second in pairwise(chain)],
        force_single_process=True,
    )


if __name__ == "__main__":
    carry_out_live(run)

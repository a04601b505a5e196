"""ezmsg: a unit for each operator in one process; messages are records, or chunks of rows."""

from collections.abc import AsyncGenerator, Iterable
from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType

import ezmsg.core as ez

from tests.benchmarks.peers import chunks, records
from tests.benchmarks.peers.job import MOTION, Job, Judged, Meter, Run, carry_out


@dataclass
class Work:
    """What all units share; as settings it would be pickled for each of them."""

    items: list
    fingers: int
    steps: ModuleType
    meter: Meter
    out: list


class Shared(ez.Unit):
    """What all units have in common."""

    work: Work


class Source(Shared):
    """Gives the input, and None at its end: one stream, as two have no order between them."""

    OUTPUT = ez.OutputStream(object)

    @ez.publisher(OUTPUT)
    async def give(self) -> AsyncGenerator:
        """The meter runs from the first item: the engine's own start is not measured."""
        self.work.meter.begin()
        for item in self.work.items:
            yield self.OUTPUT, item
        yield self.OUTPUT, None


class Operator(Shared):
    """One step; None is handed on."""

    INPUT = ez.InputStream(object)
    OUTPUT = ez.OutputStream(object)

    @ez.subscriber(INPUT)
    @ez.publisher(OUTPUT)
    async def take(self, item) -> AsyncGenerator:
        """Give what comes of an item, if anything does."""
        out = None if item is None else self.step(*item)
        if out is not None or item is None:
            yield self.OUTPUT, out

    def step(self, finger, time, values):
        """What comes of an item."""
        raise NotImplementedError


class Zero(Operator):
    """Counts relative to the unloaded fingertip; motion goes past."""

    def step(self, finger, time, values):
        """As the class says."""
        return finger, time, values if finger == MOTION else self.work.steps.zeroed(values)


class Align(Operator):
    """The motion of each touch."""

    async def initialize(self) -> None:
        """Begin without motion."""
        self.newest = self.work.steps.Newest()

    def step(self, finger, time, values):
        """As the class says."""
        if finger == MOTION:
            self.newest.take(time, values)
            return None
        return finger, values, self.newest.at(time)


class Label(Operator):
    """What the motion says."""

    def step(self, finger, counts, velocity):
        """As the class says."""
        return finger, counts, self.work.steps.label(velocity)


class Score(Operator):
    """What the window says."""

    async def initialize(self) -> None:
        """Begin with empty windows."""
        self.energies = [self.work.steps.Energy() for _ in range(self.work.fingers)]

    def step(self, finger, counts, known):
        """As the class says."""
        value = self.energies[finger].score(counts)
        return None if value is None else (finger, known, value)


class Sink(Shared):
    """Keeps what comes."""

    INPUT = ez.InputStream(object)

    @ez.subscriber(INPUT)
    async def take(self, judged) -> None:
        """Keep; the meter runs to the last one."""
        if judged is None:
            self.work.meter.end()
            raise ez.NormalTermination
        self.work.out.append(judged)


def prepare(job: Job, rows: int) -> Run:
    """Records if `rows` is 1, else chunks of that many."""
    items, steps = (job.records(), records) if rows == 1 else (job.chunks(rows), chunks)

    def run(meter: Meter) -> Iterable[Judged]:
        work = Work(items, len(job.time), steps, meter, [])
        chain = [kind() for kind in (Source, Zero, Align, Label, Score, Sink)]
        for unit in chain:
            unit.work = work
        ez.run(
            components={type(unit).__name__: unit for unit in chain},
            connections=[(first.OUTPUT, second.INPUT) for first, second in pairwise(chain)],
            force_single_process=True,
        )
        if rows == 1:
            return work.out
        return [(finger, known[len(known) - len(value) :], value) for finger, known, value in work.out]

    return run


if __name__ == "__main__":
    carry_out(prepare)

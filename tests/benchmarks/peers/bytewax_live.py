"""bytewax, live: a source that is polled when its next sample is due."""

from datetime import UTC, datetime, timedelta
from time import perf_counter_ns

import bytewax.operators as op
from bytewax.dataflow import Dataflow
from bytewax.inputs import DynamicSource, StatelessSourcePartition
from bytewax.outputs import DynamicSink, StatelessSinkPartition
from bytewax.testing import run_main

from tests.benchmarks.peers.live import Live, carry_out_live
from tests.benchmarks.peers.records import Energy, zeroed


class Samples(StatelessSourcePartition):
    """Hands over what is due."""

    def __init__(self, live: Live) -> None:
        self._live, self._next = live, 0
        live.begin()

    def next_batch(self) -> list:
        """All that is due."""
        records, due = self._live.records, []
        if self._next == len(records):
            raise StopIteration
        while self._next < len(records) and self._live.wait(records[self._next][1]) <= 0:
            finger, _, counts = records[self._next]
            due.append((finger, perf_counter_ns(), counts))
            self._next += 1
        return due

    def next_awake(self) -> datetime | None:
        """When the next one is due."""
        if self._next == len(self._live.records):
            return None
        wait = self._live.wait(self._live.records[self._next][1])
        return datetime.now(UTC) + timedelta(seconds=wait) if wait > 0 else None


class Fingertips(DynamicSource):
    """The source."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def build(self, step_id, worker_index, worker_count) -> Samples:
        """For the one worker."""
        return Samples(self._live)


class Events(StatelessSinkPartition):
    """Takes the events."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def write_batch(self, items) -> None:
        """Take."""
        for _, event in items:
            self._live.told(*event)


class Told(DynamicSink):
    """The sink."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def build(self, step_id, worker_index, worker_count) -> Events:
        """For the one worker."""
        return Events(self._live)


def zero(record):
    """Counts relative to the unloaded fingertip."""
    finger, stamp, counts = record
    return finger, stamp, zeroed(counts)


def score(energy, record):
    """What the window says."""
    energy = energy or Energy()
    finger, stamp, counts = record
    value = energy.score(counts)
    return energy, () if value is None else ((finger, stamp, value),)


def run(live: Live, _: str) -> None:
    """To the last event."""
    keys = [str(finger) for finger in range(len(live.job.time))]
    declared = Dataflow("path")
    keyed = op.key_on("key", op.input("source", declared, Fingertips(live)), lambda record: keys[record[0]])
    scored = op.stateful_flat_map("score", op.map_value("zero", keyed, zero), score)
    op.output("told", scored, Told(live))
    run_main(declared)


if __name__ == "__main__":
    carry_out_live(run)

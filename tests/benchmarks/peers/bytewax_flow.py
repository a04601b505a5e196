"""bytewax: a dataflow keyed by fingertip on one worker; items are records, or chunks of rows."""

from collections.abc import Iterable

import bytewax.operators as op
from bytewax.dataflow import Dataflow
from bytewax.testing import TestingSink, TestingSource, run_main

from tests.benchmarks.peers import chunks, records
from tests.benchmarks.peers.job import MOTION, Job, Judged, Meter, Run, carry_out

BATCH = 100  # records that the source hands over at once, which the engine still takes one by one


def flow(items, fingers: int, size: int, steps, out: list) -> Dataflow:
    """The job with the steps of one module; motion goes to every fingertip's key."""
    keys = [str(finger) for finger in range(fingers)]

    def key(item):
        finger = item[0]
        return [(each, item) for each in keys] if finger == MOTION else [(keys[finger], item)]

    def zero(item):
        finger, time, values = item
        return item if finger == MOTION else (finger, time, steps.zeroed(values))

    def align(newest, item):
        newest = newest or steps.Newest()
        finger, time, values = item
        if finger == MOTION:
            newest.take(time, values)
            return newest, ()
        return newest, ((finger, values, newest.at(time)),)

    def label(item):
        finger, counts, velocity = item
        return finger, counts, steps.label(velocity)

    def score(energy, item):
        energy = energy or steps.Energy()
        finger, counts, known = item
        value = energy.score(counts)
        return energy, () if value is None else ((finger, known, value),)

    declared = Dataflow("job")
    source = op.input("source", declared, TestingSource(items, batch_size=size))
    zeroed = op.map_value("zero", op.flat_map("key", source, key), zero)
    labelled = op.map_value("label", op.stateful_flat_map("align", zeroed, align), label)
    op.output("out", op.stateful_flat_map("score", labelled, score), TestingSink(out))
    return declared


def prepare(job: Job, rows: int) -> Run:
    """Records if `rows` is 1, else chunks of that many."""
    items = job.records() if rows == 1 else job.chunks(rows)
    steps, size = (records, BATCH) if rows == 1 else (chunks, 1)

    def run(meter: Meter) -> Iterable[Judged]:
        out: list = []
        with meter:
            run_main(flow(items, len(job.time), size, steps, out))
        judged = [each for _, each in out]
        if rows == 1:
            return judged
        return [(finger, known[len(known) - len(value) :], value) for finger, known, value in judged]

    return run


if __name__ == "__main__":
    carry_out(prepare)

"""slipflow: the flow in a plan, given batches of so many samples, as its runners give them."""

from collections.abc import Iterable
from math import inf

import numpy as np

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery
from flows.graph.testing import TestSink, TestSource
from operators import Align, Label, Labelled, Motion, Scores, Touch, Zero, ms
from tests.benchmarks.bench_engine import StepEnergy, pushes
from tests.benchmarks.peers.job import LENGTH, Job, Judged, Meter, Run, carry_out


def flow(fingers: int) -> Flow:
    """The job as a flow: labels and scores are kept."""
    job, sink = Flow("job"), TestSink()
    zeroed = job.source(TestSource(Touch, fingers=tuple(range(fingers)))) | Zero(baseline=400, spike=inf)
    aligned = zeroed & job.source(TestSource(Motion)) | Align(within=20 * ms, how="previous")
    labelled = aligned | Label(speed=0.003)
    labelled.to(sink)
    (labelled | StepEnergy()).to(sink)
    return job


def prepare(job: Job, rows: int) -> Run:
    """Batches of `rows` samples of each fingertip."""
    declared = flow(len(job.time))
    given = pushes(job, CompiledFlow(declared).entries, rows)
    for batch in (each for push in given for each in push.values()):
        _ = batch.packed  # as sources give it

    def run(meter: Meter) -> Iterable[Judged]:
        plan, out = CompiledFlow(declared), list[Delivery]()
        calls = [(plan.pusher(*push), tuple(push.values())) for push in given]
        with meter:
            for call, batches in calls:
                out += call(*batches)
            out += plan.flush()
        labels: dict[int, list[Labelled]] = {finger: [] for finger in range(len(job.time))}
        scores: dict[int, list[Scores]] = {finger: [] for finger in range(len(job.time))}
        for _, each in out:
            if isinstance(each, Labelled):
                labels[each.finger].append(each)
            elif isinstance(each, Scores):
                scores[each.finger].append(each)
        return [
            (
                finger,
                np.concatenate([each.label for each in labels[finger]])[LENGTH - 1 :],
                np.concatenate([each.probability for each in scores[finger]]),
            )
            for finger in labels
        ]

    return run


if __name__ == "__main__":
    carry_out(prepare)

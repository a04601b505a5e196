"""slipflow: the job as a compiled flow, given batches of so many samples, as its runners give them."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf

import numpy as np

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.testing import TestSink, TestSource
from operators import Align, Label, Labelled, Motion, Operator, Scores, Touch, Zero, Zeroed, ms
from operators.batch import Batch
from operators.steps import Record, RowType, Steps
from tests.benchmarks.peers.job import (
    BASELINE,
    HALF,
    LENGTH,
    MOTION,
    Chunk,
    Job,
    Judged,
    Meter,
    Run,
    carry_out,
)


@dataclass
class StepEnergy(Operator[Zeroed, Scores]):
    """Mean energy of the steps in the newest `LENGTH` samples, summed incrementally and exactly."""

    def steps(self, *given: RowType) -> Steps:
        """The step; a sum is stored for each of the newest samples."""
        state = {"sums": np.zeros(LENGTH, np.int64), "last": np.zeros(given[0].cells, np.int64), "seen": 0}
        return Steps(state=state, step=step_energy)


def step_energy(settings: Record, state: Record, row: Record, out: Record) -> bool:
    """Score a sample."""
    slot = state.seen % LENGTH
    total = state.sums[slot - 1]
    for cell in range(len(row.counts)):
        count = int(row.counts[cell])
        step = count - state.last[cell] if state.seen else 0
        state.last[cell] = count
        total += step * step
    energy = (total - state.sums[slot]) / LENGTH
    state.sums[slot] = total
    state.seen += 1
    out.time, out.probability = row.time, energy / (energy + HALF)
    return bool(state.seen >= LENGTH)


def flow(fingers: int) -> Flow:
    """The job as a flow: labels and scores are kept."""
    job, sink = Flow("job"), TestSink()
    zeroed = job.source(TestSource(Touch, fingers=tuple(range(fingers)))) | Zero(baseline=BASELINE, spike=inf)
    aligned = zeroed & job.source(TestSource(Motion)) | Align(within=20 * ms, how="previous")
    labelled = aligned | Label(speed=0.003)
    labelled.to(sink)
    (labelled | StepEnergy()).to(sink)
    return job


def batch(chunk: Chunk) -> Batch:
    """A chunk as our type; what no peer is given is what a rig without it gives."""
    finger, time, rows = chunk
    if finger == MOTION:
        return Motion(time, time, rows, np.full(rows.shape, np.nan))
    return Touch(time, rows, rows, np.ones(rows.shape, np.bool_), finger=finger)


def pushes(job: Job, entries: list[Entry], rows: int) -> list[dict[Entry, Batch]]:
    """Each row by itself in the order of time, or spans of time as a replay gives them."""
    entry = {finger: (node, finger) for node, finger in entries}  # the arm's is EVERY, which is MOTION
    if rows > 1:
        return [{entry[chunk[0]]: batch(chunk) for chunk in span} for span in job.spans(rows)]
    streams = [(MOTION, job.motion_time, job.velocity)]
    streams += [(finger, job.time[finger], job.counts[finger]) for finger in range(len(job.time))]
    single: list[tuple[int, dict[Entry, Batch]]] = []
    for finger, stamps, values in streams:
        whole = batch((finger, stamps, values))
        packed = type(whole).unpack(whole.packed, whole.finger)  # as sources give it
        single += [(t, {entry[finger]: packed[i : i + 1]}) for i, t in enumerate(stamps.tolist())]
    single.sort(key=lambda push: push[0])  # stable
    return [push for _, push in single]


def prepare(job: Job, rows: int) -> Run:
    """Batches of `rows` samples of each fingertip."""
    declared = flow(len(job.time))
    given = pushes(job, CompiledFlow(declared).entries, rows)
    for each in (each for push in given for each in push.values()):
        _ = each.packed  # as sources give it

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

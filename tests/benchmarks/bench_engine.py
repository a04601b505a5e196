"""What the dataflow costs: two streams, as-of align, label, 100-sample window, cheap score.

Run by `make bench`. Every variant scores every sample and must give the reference's scores exactly. All
variants take turns, so that a change of the machine's speed hits all of them; the table shows medians and the
ratio to the reference within the same turn. What a stage adds is what the flow up to it costs more than the
flow up to the one before; what is left without any is the plan, which hands the rows to sinks.
"""

import gc
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np
import polars as pl

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.testing import TestSink, TestSource
from operators import Align, Label, Motion, Operator, Scores, Touch, Zero, Zeroed, ms
from operators.batch import Batch, Reals
from operators.steps import Record, RowType, Steps
from tests.benchmarks.machine import print_head
from tests.benchmarks.peers.job import MOTION, Chunk, Job, Meter
from tests.benchmarks.peers.push_graph import prepare

LENGTH = 100  # samples
SAMPLES, TURNS = 20_000, 5
STAGES = ("Zero", "Align", "Label", "StepEnergy")
ALIGN = 2  # stages up to the join
SPLIT = (1, 1000)  # samples of a batch, at which the stages are told apart
LIMIT = 400.0  # counts^2 per sample: energy of the steps at which the score is one half


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
    out.time, out.probability = row.time, energy / (energy + LIMIT)
    return bool(state.seen >= LENGTH)


def streams(samples: int, seed: int) -> tuple[Touch, Motion]:
    """Barometers at 100 Hz and an arm at 125 Hz, with jitter."""
    rng = np.random.default_rng(seed)
    jitter = rng.integers(0, 2 * ms, samples)
    counts = (450 + np.cumsum(rng.integers(-9, 10, (samples, 6)), axis=0) % 60).astype(np.int16)
    touch = Touch(np.arange(samples) * 10 * ms + jitter, counts, counts, np.ones((samples, 6), np.bool_))
    steps = samples * 5 // 4
    moving = (np.arange(steps) // 80 % 2)[:, None]  # stop and go
    velocity = np.where(moving, rng.normal(0, 0.05, (steps, 6)), 0.0)
    stamps = np.arange(steps) * 8 * ms + rng.integers(0, 2 * ms, steps)
    return touch, Motion(stamps, stamps, velocity, np.full((steps, 6), np.nan))


def plain(touch: Touch, motion: Motion) -> Reals:
    """The reference: polars join_asof and numpy over the whole recording."""
    velocity = {f"v{axis}": motion.velocity[:, axis] for axis in range(6)}
    joined = pl.DataFrame({"t": touch.time}).join_asof(
        pl.DataFrame({"t": motion.time, **velocity}), on="t", strategy="backward", tolerance=20 * ms
    )
    speed = np.hypot(joined["v0"].to_numpy(), joined["v1"].to_numpy())
    label = np.where(speed > 0.003, 1, 0)
    label[(speed >= 0.3) | np.isnan(speed)] = -1
    counts = touch.counts.astype(np.int64) - 400
    steps = np.diff(counts, axis=0, prepend=counts[:1])
    sums = np.concatenate((np.zeros(1, np.int64), np.cumsum((steps * steps).sum(axis=1))))
    energy = (sums[LENGTH:] - sums[:-LENGTH]) / LENGTH
    scores: Reals = energy / (energy + LIMIT)
    return scores


def flow(stages: int = len(STAGES)) -> Flow:
    """The job as a flow, or no more than its first stages."""
    job = Flow("job")
    touch, motion = job.source(TestSource(Touch, fingers=(0,))), job.source(TestSource(Motion))
    zero = Zero(baseline=400, spike=inf)
    if stages < ALIGN:
        (touch | zero if stages else touch).to(TestSink())
        motion.to(TestSink())
        return job
    aligned = (touch | zero) & motion | Align(within=20 * ms, how="previous")
    labelled = aligned | Label(speed=0.003) if stages > ALIGN else aligned
    (labelled | StepEnergy() if stages == len(STAGES) else labelled).to(TestSink())
    return job


def through_flow(rows: int, stages: int = len(STAGES)) -> Callable[[Touch, Motion], Reals]:
    """The job, or its first stages, carried out by slipflow in batches of `rows` barometer samples."""

    def run(touch: Touch, motion: Motion) -> Reals:
        plan, out = CompiledFlow(flow(stages)), list[Delivery]()
        given = pushes(job_of(touch, motion), plan.entries, rows)
        calls = [(plan.pusher(*push), tuple(push.values())) for push in given]
        for each in (each for _, batches in calls for each in batches):
            _ = each.packed  # as sources give it
        began = time.process_time()
        for call, batches in calls:
            out += call(*batches)
        out += plan.flush()
        timed.append(time.process_time() - began)
        scores = [batch.probability for _, batch in out if isinstance(batch, Scores)]
        return np.concatenate(scores) if scores else np.empty(0)

    return run


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


def job_of(touch: Touch, motion: Motion) -> Job:
    """The streams as every engine is given them."""
    return Job(touch.time[None], touch.counts[None], motion.time, motion.velocity)


def plain_python(touch: Touch, motion: Motion) -> Reals:
    """The job by functions that call each other with each record, of tuples, floats and a deque."""
    meter = Meter()
    run = prepare(job_of(touch, motion), 1)
    scores = np.array([score for _, _, score in run(meter)])
    timed.append(meter.spent)
    gc.disable()  # the meter enabled it
    return scores


timed: list[float] = []  # s, of the newest run: making its input is not its cost


def main() -> None:
    """Measure and print the tables."""
    print_head(f"{SAMPLES} samples, {TURNS} turns")
    touch, motion = streams(SAMPLES, 0)
    variants: dict[str, Callable[[Touch, Motion], Reals]] = {"plain Python, per record": plain_python}
    variants |= {f"slipflow, batches of {rows}": through_flow(rows) for rows in (1, 10, 100, 1000)}
    variants["slipflow, whole"] = through_flow(SAMPLES)
    expected = plain(touch, motion)
    cost: dict[str, list[float]] = {name: [] for name in ("polars join_asof + numpy", *variants)}
    upto = {(rows, stages): list[float]() for stages in range(len(STAGES) + 1) for rows in SPLIT}
    gc.disable()
    for _ in range(TURNS + 1):  # the first turn warms up
        began = time.process_time()
        plain(touch, motion)
        cost["polars join_asof + numpy"].append(time.process_time() - began)
        for name, run in variants.items():
            result = run(touch, motion)
            if result.tobytes() != expected.tobytes():
                raise SystemExit(f"{name}: wrong scores")
            cost[name].append(timed.pop())
        for (rows, stages), spent in upto.items():
            through_flow(rows, stages)(touch, motion)
            spent.append(timed.pop())
        gc.collect()
    print(f"{'':28}{'us/sample':>10}{'ratio':>8}")
    reference = cost["polars join_asof + numpy"][1:]
    for name, seconds in cost.items():
        ratio = statistics.median(a / b for a, b in zip(seconds[1:], reference, strict=True))
        print(f"{name:28}{statistics.median(seconds[1:]) / SAMPLES * 1e6:10.2f}{ratio:8.1f}")
    print(f"{'each stage adds, batches of':28}" + "".join(f"{rows:10}" for rows in SPLIT))
    totals = {key: statistics.median(spent[1:]) / SAMPLES * 1e6 for key, spent in upto.items()}
    for stages, name in enumerate(("plan", *STAGES)):
        added = [totals[rows, stages] - totals.get((rows, stages - 1), 0.0) for rows in SPLIT]
        print(f"{name:28}" + "".join(f"{each:10.2f}" for each in added))


if __name__ == "__main__":
    main()

"""What the dataflow costs: two streams, as-of align, label, 100-sample window, cheap score.

Run by `make bench`. Every variant must give the reference's scores exactly. All take turns; the table shows
medians and the ratio to the reference within the same turn.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import hypot, inf
from statistics import median
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.testing import TestSink, TestSource
from operators import Align, Label, Motion, Operator, Scores, Touch, Zero, Zeroed, ms
from operators.batch import Batch, Reals
from operators.steps import Record, RowType, Steps
from tests.benchmarks.machine import print_head, take_turns

SAMPLES, TURNS = 20_000, 5
REFERENCE = "polars join_asof + numpy"
BASELINE: Final = 400  # counts of the unloaded fingertip
WITHIN: Final = 20 * ms  # by which motion may be older than the touch that it belongs to
SLIP: Final = 0.003  # m/s, above which the label is slip
LIMIT: Final = 0.3  # m/s, from which it is unknown
LENGTH: Final = 100  # samples of a window
HALF: Final = 400.0  # counts^2, the mean energy of a window's steps at which the score is one half

Job: TypeAlias = Callable[[], tuple[float, Reals]]  # returns CPU time, s, and scores


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


def declared() -> Flow:
    """The job as a flow: labels and scores are kept."""
    job, sink = Flow("job"), TestSink()
    zeroed = job.source(TestSource(Touch)) | Zero(baseline=BASELINE, spike=inf)
    aligned = zeroed & job.source(TestSource(Motion)) | Align(within=WITHIN, how="previous")
    labelled = aligned | Label(speed=SLIP)
    labelled.to(sink)
    (labelled | StepEnergy()).to(sink)
    return job


def pushes(entries: Sequence[Entry], streams: Sequence[Batch], rows: int) -> list[dict[Entry, Batch]]:
    """Each row by itself in the order of time, or spans of so many samples, as a replay gives them."""
    given = [
        (entry, type(each).unpack(each.packed, each.finger))  # as sources give it
        for entry, each in zip(entries, streams, strict=True)
    ]
    if rows == 1:
        single = [
            (time, {entry: each[row : row + 1]})
            for entry, each in reversed(given)  # motion first where stamps are equal
            for row, time in enumerate(each.time.tolist())
        ]
        return [push for _, push in sorted(single, key=lambda push: push[0])]
    edges = np.arange(0, len(streams[0]) + rows, rows) * 10 * ms
    cuts = [each.time.searchsorted(edges) for _, each in given]
    return [
        {entry: each[cut[k] : cut[k + 1]] for (entry, each), cut in zip(given, cuts, strict=True)}
        for k in range(len(edges) - 1)
    ]


def slipflow(touch: Touch, motion: Motion, rows: int) -> Job:
    """Batches of so many samples through the compiled flow."""
    flow = declared()
    given = pushes(CompiledFlow(flow).entries, (touch, motion), rows)

    def run() -> tuple[float, Reals]:
        plan, found = CompiledFlow(flow), list[Delivery]()
        calls = [(plan.pusher(*push), tuple(push.values())) for push in given]
        began = time.process_time()
        for call, batches in calls:
            found += call(*batches)
        found += plan.flush()
        spent = time.process_time() - began
        scores = [batch.probability for _, batch in found if isinstance(batch, Scores)]
        return spent, np.concatenate(scores)

    return run


def plain_python(touch: Touch, motion: Motion) -> Job:
    """Each operator calls the next one with each record."""
    records = [
        (stamp, stream is touch, tuple(row))
        for stream, values in ((motion, motion.velocity), (touch, touch.counts))
        for stamp, row in zip(stream.time.tolist(), values.tolist(), strict=True)
    ]
    records.sort(key=lambda record: record[0])  # stable

    def run() -> tuple[float, Reals]:
        chain = Chain()
        began = time.process_time()
        for stamp, touches, values in records:
            (chain.zero if touches else chain.move)(stamp, values)
        return time.process_time() - began, np.array(chain.scores)

    return run


class Chain:
    """Operators in plain Python: floats, tuples and a deque."""

    def __init__(self) -> None:
        self.labels, self.scores = list[int](), list[float]()
        self._moved, self._velocity = -WITHIN - 1, tuple[float, ...]()
        self._steps, self._total, self._last = deque[int](), 0, tuple[int, ...]()

    def move(self, time: int, velocity: tuple[float, ...]) -> None:
        """Remember the newest motion."""
        self._moved, self._velocity = time, velocity

    def zero(self, time: int, counts: tuple[int, ...]) -> None:
        """Subtract the baseline."""
        a, b, c, d, e, f = counts
        self.align(time, (a - BASELINE, b - BASELINE, c - BASELINE, d - BASELINE, e - BASELINE, f - BASELINE))

    def align(self, time: int, counts: tuple[int, ...]) -> None:
        """Find the motion of a touch, if it is near enough."""
        self.label(counts, self._velocity if time - self._moved <= WITHIN else None)

    def label(self, counts: tuple[int, ...], velocity: tuple[float, ...] | None) -> None:
        """Label slip (1), static (0) or unknown (-1)."""
        speed = hypot(velocity[0], velocity[1]) if velocity else LIMIT
        self.labels.append((1 if speed > SLIP else 0) if speed < LIMIT else -1)
        self.score(counts)

    def score(self, counts: tuple[int, ...]) -> None:
        """Score the window that the sample completes."""
        a, b, c, d, e, f = counts
        u, v, w, x, y, z = self._last or counts
        step = (a - u) ** 2 + (b - v) ** 2 + (c - w) ** 2 + (d - x) ** 2 + (e - y) ** 2 + (f - z) ** 2
        self._last = counts
        self._steps.append(step)
        self._total += step
        if len(self._steps) == LENGTH:
            energy = self._total / LENGTH
            self._total -= self._steps.popleft()
            self.scores.append(energy / (energy + HALF))


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
        pl.DataFrame({"t": motion.time, **velocity}), on="t", strategy="backward", tolerance=WITHIN
    )
    speed = np.hypot(joined["v0"].to_numpy(), joined["v1"].to_numpy())
    label = np.where(speed > SLIP, 1, 0)
    label[(speed >= LIMIT) | np.isnan(speed)] = -1
    counts = touch.counts.astype(np.int64) - BASELINE
    steps = np.diff(counts, axis=0, prepend=counts[:1])
    sums = np.concatenate((np.zeros(1, np.int64), np.cumsum((steps * steps).sum(axis=1))))
    energy = (sums[LENGTH:] - sums[:-LENGTH]) / LENGTH
    scores: Reals = energy / (energy + HALF)
    return scores


def reference(touch: Touch, motion: Motion) -> tuple[float, Reals]:
    """Return the CPU time of the reference, s, and its scores."""
    began = time.process_time()
    scores = plain(touch, motion)
    return time.process_time() - began, scores


def checked(name: str, job: Job, expected: Reals) -> float:
    """Return the CPU time of a job, s, whose scores must be the expected ones."""
    spent, scores = job()
    if scores.tobytes() != expected.tobytes():
        raise SystemExit(f"{name}: wrong scores")
    return spent


def main() -> None:
    """Measure and print the table."""
    print_head(f"{SAMPLES} samples, {TURNS} turns")
    touch, motion = streams(SAMPLES, 0)
    expected = plain(touch, motion)
    jobs: dict[str, Job] = {REFERENCE: partial(reference, touch, motion)}
    jobs["plain Python, per record"] = plain_python(touch, motion)
    for rows in (1, 10, 100, 1000, SAMPLES):
        name = "slipflow, whole" if rows == SAMPLES else f"slipflow, batches of {rows}"
        jobs[name] = slipflow(touch, motion, rows)
    measures = {name: partial(checked, name, job, expected) for name, job in jobs.items()}
    costs = take_turns(measures, TURNS)
    print(f"{'':28}{'us/sample':>10}{'ratio':>8}")
    for name, seconds in costs.items():
        ratio = median(a / b for a, b in zip(seconds, costs[REFERENCE], strict=True))
        print(f"{name:28}{median(seconds) / SAMPLES * 1e6:10.2f}{ratio:8.1f}")


if __name__ == "__main__":
    main()

"""What the dataflow costs: two streams, as-of align, label, 100-sample window, cheap score.

Run by `make bench`. Every variant scores every sample and must give the reference's scores exactly. All
variants take turns, so that a change of the machine's speed hits all of them; the table shows medians and the
ratio to the reference within the same turn.
"""

import argparse
import gc
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import polars as pl
from numpy.typing import NDArray

from flows.graph import Flow
from flows.plan import Delivery, Entry, Plan
from flows.testing import TestSink, TestSource
from operators import Align, Label, Labelled, Motion, Operator, Scores, Touch, Zero, ms
from operators.batch import Batch, Reals

LENGTH = 100  # samples
LIMIT = 400.0  # counts^2 per sample: energy of the steps at which the score is one half


@dataclass
class StepEnergy(Operator[Labelled, Scores]):
    """Mean energy of the steps in the newest `LENGTH` samples, summed incrementally and exactly."""

    _sums: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(LENGTH, np.int64), init=False, repr=False
    )
    _seen: int = field(
        default=0, init=False, repr=False
    )  # samples; the sum up to the k-th is at k mod LENGTH
    _last: NDArray[np.int64] | None = field(default=None, init=False, repr=False)  # (1, 6)

    def process(self, batch: Labelled) -> Scores:
        """Score the samples that complete a window."""
        counts, seen, sums = batch.counts.astype(np.int64), self._seen, self._sums  # (n, 6)
        last = counts[:1] if self._last is None else self._last
        self._last, self._seen = counts[-1:], seen + len(batch)
        if len(batch) == 1:
            step, slot = (counts - last).ravel(), seen % LENGTH
            total = sums.item(slot - 1) + step.dot(step).item()
            energy = (total - sums.item(slot)) / LENGTH
            sums[slot] = total
            if seen < LENGTH - 1:
                return Scores.empty()
            return Scores(batch.time, np.array([energy / (energy + LIMIT)]))
        steps = np.diff(counts, axis=0, prepend=last)  # (n, 6)
        slot = seen % LENGTH  # of the oldest
        steps_energy = np.einsum("ij,ij->i", steps, steps)  # (n,)
        totals = sums[slot - 1] + steps_energy.cumsum()  # (n,)
        ordered = np.concatenate((sums[slot:], sums[:slot], totals))  # (LENGTH + n,)
        newest, slot = ordered[-LENGTH:], LENGTH - self._seen % LENGTH
        self._sums = np.concatenate((newest[slot:], newest[:slot]))
        first = max(LENGTH - 1 - seen, 0)  # of the batch, that completes a window
        energies = (ordered[LENGTH + first :] - ordered[first:-LENGTH]) / LENGTH
        return Scores(batch.time[first:], energies / (energies + LIMIT))


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


def flow() -> Flow:
    """The job as a flow."""
    job = Flow("job")
    zeroed = job.source(TestSource(Touch)) | Zero(baseline=400)
    aligned = zeroed & job.source(TestSource(Motion)) | Align(within=20 * ms, how="previous")
    (aligned | Label(speed=0.003) | StepEnergy()).to(TestSink())
    return job


def through_flow(rows: int) -> Callable[[Touch, Motion], Reals]:
    """The job carried out by slipflow in batches of `rows` barometer samples."""

    def run(touch: Touch, motion: Motion) -> Reals:
        plan = Plan(flow())
        out: list[Reals] = []

        def take(deliveries: list[Delivery]) -> None:
            out.extend(batch.probability for _, batch in deliveries if isinstance(batch, Scores))

        if rows == 1:  # live: each sample by itself, in the order of time
            left, right = plan.entries
            order = np.argsort(np.concatenate((touch.time, motion.time)), kind="stable")
            pushes: list[dict[Entry, Batch]] = [
                ({left: touch[i : i + 1]} if i < len(touch) else {right: motion[i - len(touch) :][:1]})
                for i in order.tolist()
            ]
            began = time.process_time()
            for push in pushes:
                take(plan.push(push))
        else:
            left, right = plan.entries
            edges = np.arange(0, len(touch) + rows, rows) * 10 * ms  # spans that hold `rows` touch samples
            first, second = (np.searchsorted(batch.time, edges).tolist() for batch in (touch, motion))
            spans: list[dict[Entry, Batch]] = [
                {left: touch[first[i] : first[i + 1]], right: motion[second[i] : second[i + 1]]}
                for i in range(len(edges) - 1)
            ]
            began = time.process_time()
            for span in spans:
                take(plan.push(span))
        take(plan.flush())
        timed.append(time.process_time() - began)
        return np.concatenate(out)

    return run


timed: list[float] = []  # s, of the newest run through a flow: making its input is not its cost


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    touch, motion = streams(options.samples, options.seed)
    variants = {f"slipflow, batches of {rows}": through_flow(rows) for rows in (1, 10, 100, 1000)}
    variants["slipflow, whole"] = through_flow(options.samples)
    expected = plain(touch, motion)
    cost: dict[str, list[float]] = {name: [] for name in ("polars join_asof + numpy", *variants)}
    gc.disable()
    for _ in range(options.turns + 1):  # the first turn warms up
        began = time.process_time()
        plain(touch, motion)
        cost["polars join_asof + numpy"].append(time.process_time() - began)
        for name, run in variants.items():
            result = run(touch, motion)
            if result.tobytes() != expected.tobytes():
                raise SystemExit(f"{name}: wrong scores")
            cost[name].append(timed.pop())
        gc.collect()
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    )
    revision = commit.stdout.strip()
    print(f"{options.samples} samples, {options.turns} turns, seed {options.seed}, commit {revision}")
    machine = platform.processor() or platform.machine()
    print(f"{machine}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}")
    print(f"{'':28}{'us/sample':>10}{'ratio':>8}")
    reference = cost["polars join_asof + numpy"][1:]
    for name, seconds in cost.items():
        ratio = statistics.median(a / b for a, b in zip(seconds[1:], reference, strict=True))
        print(f"{name:28}{statistics.median(seconds[1:]) / options.samples * 1e6:10.2f}{ratio:8.1f}")


if __name__ == "__main__":
    main()

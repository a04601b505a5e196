"""What the dataflow costs: two streams, as-of align, label, 100-sample window, cheap score.

Run by `make bench`. Every variant must give the reference's scores exactly. All take turns; the table shows
medians and the ratio to the reference within the same turn.
"""

import time
from functools import partial
from statistics import median

import numpy as np
import polars as pl

from operators import Motion, Touch, ms
from operators.batch import Reals
from tests.benchmarks.engine_job import HALF, LENGTH, Job, plain_python, slipflow
from tests.benchmarks.machine import print_head, take_turns

SAMPLES, TURNS = 20_000, 5
REFERENCE = "polars join_asof + numpy"


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

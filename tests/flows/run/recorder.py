"""Recordings of random touch and motion."""

from pathlib import Path

import numpy as np

from flows.run.clocks import EventClock
from operators import Batch, Motion, Touch, ms, s
from operators.ports import Run
from storage import Dataset
from tests.storage.made import run_sink

START = 1_700_000_000 * s


def record(root: Path, session: str, seconds: int, fingers: tuple[int, ...] = (0, 1), seed: int = 0) -> None:
    """Record a session in parts of 10 s."""
    random, batches = np.random.default_rng(seed), list[Batch]()
    for begin in range(START, START + seconds * s, s):
        for finger in fingers:
            time = begin + finger + np.arange(100) * 10 * ms
            counts = random.integers(200, 500, (100, 6)).astype(np.int16)
            batches.append(Touch(time, counts, counts, counts > 0, finger=finger))
        time = begin + 3 * ms + np.arange(125) * 8 * ms
        velocity = random.normal(0, 0.01, (125, 6))
        batches.append(Motion(time, time, velocity, np.full((125, 6), np.nan)))
    run = Run(session, "recorded", EventClock(START), START, live=False)
    dataset = Dataset(root)
    dataset.part_span = 10 * s
    run_sink(dataset, run, batches)

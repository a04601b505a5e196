"""What a sample costs the operators of the flow `live` where numba is not installed, as on a small machine.

Run by `make bench`. One fingertip, batches of one row; CPU time, medians.
"""

import statistics
import sys
import time
from typing import Any, cast

import numpy as np

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSink, TestSource
from operators import Debounce, Health, Score, Touch, Zero, ms, s
from storage import load_detector
from tests.benchmarks.machine import print_head

SAMPLES, TURNS = 1000, 5


def live(operators: int) -> Flow:
    """The first operators of the flow."""
    flow = Flow("live")
    stream: Any = flow.source(TestSource(Touch, fingers=(0,)))
    (stream | Health(clear_after=2 * s)).to(TestSink())
    following = Zero(), Score(load_detector("tcn")), Debounce(release=10)
    for operator in following[: operators - 1]:
        stream = stream | operator
    stream.to(TestSink())
    return flow


def cost(flow: Flow) -> float:
    """Return what a sample costs, us."""
    compiled, rng, turns = CompiledFlow(flow), np.random.default_rng(0), list[float]()
    push = compiled.pusher(compiled.entries[0])
    for turn in range(TURNS + 1):  # the first one measures the baseline
        counts = rng.integers(-3, 4, (SAMPLES, 6)) + 600
        times = np.arange(turn * SAMPLES, (turn + 1) * SAMPLES) * 10 * ms
        rows = Touch.rows(times, counts, counts, np.ones_like(counts), finger=0)
        pieces = [rows[row : row + 1] for row in range(SAMPLES)]
        began = time.process_time()
        for piece in pieces:
            push(piece)
        turns.append((time.process_time() - began) / SAMPLES * 1e6)
    return statistics.median(turns[1:])


def main() -> None:
    """Measure and print the table."""
    cast("dict[str, Any]", sys.modules)["numba"] = None  # as if it were not installed
    print_head(f"medians of {TURNS} turns")
    print("us per sample, batches of one, without numba")
    for number, name in enumerate(("Health", "with Zero", "with Score", "with Debounce"), 1):
        print(f"{name:20}{cost(live(number)):9.0f}", flush=True)


if __name__ == "__main__":
    main()

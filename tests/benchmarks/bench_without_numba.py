"""What a sample costs the operators of the flow `live` where numba is not installed, as on a small machine.

Run by `make bench`. One fingertip, batches of one row; CPU time, medians.
"""

import sys
from statistics import median
from typing import Any, cast

import numpy as np

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Debounce, Health, Score, Touch, Zero, s
from storage import load_detector
from tests.benchmarks.machine import live_cost, print_head, take_turns

SAMPLES, TURNS = 1000, 5
NAMES = ("Health", "with Zero", "with Score", "with Debounce")


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


def main() -> None:
    """Measure and print the table."""
    cast("dict[str, Any]", sys.modules)["numba"] = None  # as if it were not installed
    print_head(f"medians of {TURNS} turns")
    print("us per sample, batches of one, without numba")
    counts = (np.random.default_rng(0).integers(-3, 4, (SAMPLES, 6)) + 600).astype(np.int16)
    flows = {name: live_cost(live(number), counts) for number, name in enumerate(NAMES, 1)}
    for name, costs in take_turns(flows, TURNS).items():
        print(f"{name:20}{median(costs):9.0f}")


if __name__ == "__main__":
    main()

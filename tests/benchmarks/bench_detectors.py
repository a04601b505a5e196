"""What a sample costs our TCN, by its filters: streaming, and on windows; batch 1, one core, CPU time.

Run by `make bench`. Live takes sample after sample through a compiled flow. Windowed takes a whole window for
each sample, as those must who do not stream. Weights are random: they cost what trained ones do. All
variants take turns; the table shows medians.
"""

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Debounce, Score, Touch, Zero, Zeroed, ms
from operators.batch import Counts
from operators.detectors import Detector, Tcn
from operators.detectors.tcn import shapes
from operators.operator import Operator
from tests.benchmarks.machine import live_cost, print_head, take_turns

FILTERS = (4, 8, 12, 16, 24)
SAMPLES = 2000  # of one fingertip
TURNS = 15


def network(filters: int) -> Tcn:
    """Our TCN with random weights, and the receptive field of the shipped one."""
    rng = np.random.default_rng([0, filters])
    sizes = shapes(taps=8, filters=filters, units=24, blocks=4)
    weights = {name: rng.normal(size=shape) / np.sqrt(np.prod(shape[:-1])) for name, shape in sizes.items()}
    scales = {"position_scale": np.array([8.0]), "step_scale": np.array([1.5])}
    return Tcn(weights | scales | {"dilations": np.array([1, 2, 4, 8])})


def live(counts: Counts, *operators: Operator[Any, Any]) -> Callable[[], float]:
    """Return the cost of a flow of these operators."""
    flow = Flow("live")
    stream: Any = flow.source(TestSource(Touch, fingers=(0,)))
    for each in operators:
        stream |= each
    stream.to(TestSink())
    return live_cost(flow, counts)


def windowed(detector: Detector, counts: Counts, number: int) -> Callable[[], float]:
    """Return the cost of one window after the other."""
    windows = sliding_window_view(counts, detector.length, axis=0)[:number, None].swapaxes(2, 3).copy()

    def measure() -> float:
        began = time.process_time()
        for window in windows:  # (1, length, 6)
            detector.score(window)
        return (time.process_time() - began) / number * 1e6

    return measure


def variants(filters: int, counts: Counts) -> dict[str, Callable[[], float]]:
    """What is measured for one size."""
    tcn, valid = network(filters), np.ones_like(counts, np.bool_)
    windows = sliding_window_view(counts, tcn.length, axis=0)[:50].swapaxes(1, 2)
    touch = Zeroed(np.arange(len(counts)) * 10 * ms, counts, counts, valid, finger=0)
    np.testing.assert_allclose(tcn.score(windows), Score(tcn).push(touch).probability[:50], atol=1e-5)
    return {
        "live: Zero, Score, Debounce": live(counts, Zero(), Score(tcn), Debounce()),
        "live: Zero": live(counts, Zero()),
        "windowed, numpy": windowed(tcn, counts, 200),
    }


def main() -> None:
    """Measure and print the table."""
    print_head(f"medians of {TURNS} turns")
    rng = np.random.default_rng(0)
    counts = (-250 + np.cumsum(rng.integers(-20, 21, (SAMPLES, 6)), axis=0) % 250).astype(np.int16)
    runs = {(name, each): run for each in FILTERS for name, run in variants(each, counts).items()}
    costs = take_turns(runs, TURNS)
    print(f"{'us per sample, by filters':46}" + "".join(f"{filters:9}" for filters in FILTERS))
    for name in dict.fromkeys(name for name, _ in costs):
        print(f"{name:46}" + "".join(f"{median(costs[name, filters]):9.2f}" for filters in FILTERS))


if __name__ == "__main__":
    main()

"""What a sample costs our TCN, by its filters: streaming, and on windows; batch 1, one core, CPU time.

Run by `make bench`. Live takes sample after sample through a compiled flow. Windowed takes a whole window for
each sample, as those must who do not stream. Weights are random: they cost what trained ones do. All
variants take turns, so that a change of the machine's speed affects all of them; tables show medians.
"""

import gc
import statistics
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSink, TestSource
from operators import Debounce, Score, Touch, Zero, Zeroed, ms
from operators.batch import Counts
from operators.detectors import Detector, Tcn
from operators.detectors.tcn import shapes
from operators.operator import Operator
from tests.benchmarks.machine import print_head

FILTERS = (4, 8, 12, 16, 24)
SAMPLES = 2000  # of one fingertip
TURNS = 15
Run = Callable[[], int]  # says how many samples it scored
SomeTouch = TypeVar("SomeTouch", bound=Touch)


def network(filters: int) -> Tcn:
    """Our TCN with random weights, and the receptive field of the shipped one."""
    rng = np.random.default_rng([0, filters])
    sizes = shapes(taps=8, filters=filters, units=24, blocks=4)
    weights = {name: rng.normal(size=shape) / np.sqrt(np.prod(shape[:-1])) for name, shape in sizes.items()}
    scales = {"position_scale": np.array([8.0]), "step_scale": np.array([1.5])}
    return Tcn(weights | scales | {"dilations": np.array([1, 2, 4, 8])})


def touch(kind: type[SomeTouch], counts: Counts) -> SomeTouch:
    """Return samples of one fingertip at 100 Hz, all valid."""
    valid = np.ones_like(counts, np.bool_)
    return kind(np.arange(len(counts)) * 10 * ms, counts, counts, valid, finger=0)


def live(counts: Counts, *operators: Operator[Any, Any]) -> Run:
    """Return a run of a flow on batches of one, all of one time, so that none is late."""
    flow, rows = Flow("live"), touch(Touch, counts).packed.copy()
    stream: Any = flow.source(TestSource(Touch, fingers=(0,)))
    for each in operators:
        stream |= each
    stream.to(TestSink())
    compiled = CompiledFlow(flow)
    push = compiled.pusher(*compiled.entries)
    push(Touch.unpack(rows.copy(), 0))
    rows["time"] = rows["time"][-1]
    pieces = [rows[at : at + 1] for at in range(len(rows))]

    def run() -> int:
        for row in pieces:
            push(Touch.unpack(row, 0))
        return len(pieces)

    return run


def windowed(detector: Detector, counts: Counts, number: int) -> Run:
    """One window after the other."""
    windows = sliding_window_view(counts, detector.length, axis=0)[:number, None].swapaxes(2, 3).copy()

    def run() -> int:
        for window in windows:  # (1, length, 6)
            detector.score(window)
        return number

    return run


def variants(filters: int, counts: Counts) -> dict[str, Run]:
    """What is measured for one size."""
    tcn = network(filters)
    windows = sliding_window_view(counts, tcn.length, axis=0)[:50].swapaxes(1, 2)
    streamed = Score(tcn).push(touch(Zeroed, counts)).probability[:50]
    np.testing.assert_allclose(tcn.score(windows), streamed, atol=1e-5)
    ones = np.ones((64, 64), np.float32)  # small enough for one thread
    needed = sum(each.size for each in tcn.weights.values() if each.ndim > 1)  # multiply-adds of a sample
    return {
        "live: Zero, Score, Debounce": live(counts, Zero(), Score(tcn), Debounce()),
        "live: Zero": live(counts, Zero()),
        "windowed, numpy": windowed(tcn, counts, 200),
        "multiply-adds as matrix products": lambda: (
            sum(64**2 * len(ones @ ones) for _ in range(500)) // needed
        ),
    }


def main() -> None:
    """Measure and print the table."""
    print_head(f"medians of {TURNS} turns")
    rng = np.random.default_rng(0)
    counts = (-250 + np.cumsum(rng.integers(-20, 21, (SAMPLES, 6)), axis=0) % 250).astype(np.int16)
    runs = {(name, each): run for each in FILTERS for name, run in variants(each, counts).items()}
    cost: dict[tuple[str, int], list[float]] = {key: [] for key in runs}
    gc.disable()
    for turn in range(TURNS + 1):  # the first one warms up
        for key, run in runs.items():
            began = time.process_time()
            samples = run()
            if turn:
                cost[key].append((time.process_time() - began) / samples * 1e6)
        gc.collect()
    print(f"{'us per sample, by filters':46}" + "".join(f"{filters:9}" for filters in FILTERS))
    for name in dict.fromkeys(name for name, _ in cost):
        medians = [statistics.median(cost[name, filters]) for filters in FILTERS]
        print(f"{name:46}" + "".join(f"{median:9.2f}" for median in medians))


if __name__ == "__main__":
    main()

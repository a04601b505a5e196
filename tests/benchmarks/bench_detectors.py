"""What a sample costs our TCN, by its filters: streaming, and on windows; batch 1, one core, CPU time.

Run by `make bench`. Streaming takes sample after sample, of one fingertip or of 64 or 1000 that are sampled
together, then per fingertip; live is one fingertip's batches of one through `Score`. Windowed takes a whole
window for each sample, as those must who do not stream. Weights are random: they cost what trained ones do.
The live path is `Score` with the operators around it. All variants take turns, so that a change of the
machine's speed affects all of them; tables show medians.
"""

import argparse
import gc
import os
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from operators import Debounce, Score, Touch, Zero, Zeroed, ms
from operators.batch import Batch, Counts, Scores
from operators.detectors import Detector, Tcn
from operators.detectors.tcn import shapes
from operators.operator import Operator
from tests.benchmarks.machine import commit, machine
from tests.benchmarks.windowed_runtimes import OnnxWindowed

FILTERS = (4, 8, 12, 16, 24)
FINGERS = (64, 1000)
SAMPLES = 2000  # of one fingertip
Run = Callable[[], int]  # says how many samples it scored


def network(filters: int, seed: int) -> Tcn:
    """Our TCN with random weights: a receptive field of 100 samples."""
    rng = np.random.default_rng([seed, filters])
    sizes = shapes(taps=8, filters=filters, units=24, blocks=3)
    weights = {name: rng.normal(size=shape) / np.sqrt(np.prod(shape[:-1])) for name, shape in sizes.items()}
    scales = {"position_scale": np.array([8.0]), "step_scale": np.array([1.5])}
    return Tcn(weights | scales | {"dilations": np.array([1, 2, 4])})


def streaming(tcn: Tcn, counts: Counts, fingers: int) -> Run:
    """Sample after sample, of some fingertips at once."""
    stream, rows = tcn.stream(fingers), [row[None, None].repeat(fingers, axis=1) for row in counts]

    def run() -> int:
        for row in rows:
            stream.push(row)
        return len(rows) * fingers

    return run


def live(tcn: Tcn, counts: Counts) -> Run:
    """Batches of one through the operator."""
    time = np.arange(len(counts)) * 10 * ms
    return in_rows(Score(tcn), Zeroed(time, counts, counts, np.ones_like(counts, np.bool_), finger=0))


def in_rows(step: Operator[Any, Any], batch: Batch) -> Run:
    """Batches of one through an operator."""
    rows = [batch[row : row + 1] for row in range(len(batch))]

    def run() -> int:
        fresh = step.reset_copy()
        for row in rows:
            fresh.push(row)
        return len(rows)

    return run


def around(counts: Counts, seed: int) -> dict[str, Run]:
    """Operators before and after `Score` on the live path of one fingertip."""
    time = np.arange(len(counts)) * 10 * ms
    touch = Touch(time, counts + 700, counts, np.ones_like(counts, np.bool_), finger=0)
    probability = np.random.default_rng(seed).random(len(counts))
    return {
        "Zero": in_rows(Zero(), touch),
        "Debounce": in_rows(Debounce(), Scores(time, probability, finger=0)),
    }


def windowed(detector: Detector, counts: Counts, number: int) -> Run:
    """One window after the other."""
    windows = sliding_window_view(counts, detector.length, axis=0)[:number, None].swapaxes(2, 3).copy()

    def run() -> int:
        for window in windows:  # (1, length, 6)
            detector.score(window)
        return number

    return run


def variants(filters: int, counts: Counts, seed: int) -> dict[str, Run]:
    """What is measured for one size."""
    tcn = network(filters, seed)
    runtime = OnnxWindowed(tcn)
    windows = sliding_window_view(counts, tcn.length, axis=0)[:50].swapaxes(1, 2)
    streamed = tcn.stream().push(counts[:, None])[tcn.length - 1 :][:50, 0]
    for same in (tcn.score(windows), runtime.score(windows)):
        np.testing.assert_allclose(same, streamed, atol=1e-5)
    return {
        "streaming": streaming(tcn, counts, 1),
        "live, through Score": live(tcn, counts),
        **{
            f"streaming, {fingers} fingertips, each": streaming(tcn, counts[: SAMPLES // fingers], fingers)
            for fingers in FINGERS
        },
        "windowed, numpy": windowed(tcn, counts, 200),
        "windowed, onnxruntime": windowed(runtime, counts, 100),
    }


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--filters", type=int, nargs="+", default=FILTERS)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    counts = (-250 + np.cumsum(rng.integers(-20, 21, (SAMPLES, 6)), axis=0) % 250).astype(np.int16)
    runs = {
        (name, filters): run
        for filters in options.filters
        for name, run in variants(filters, counts, options.seed).items()
    }
    runs |= {(name, 0): run for name, run in around(counts, options.seed).items()}
    cost: dict[tuple[str, int], list[float]] = {key: [] for key in runs}
    gc.disable()
    for turn in range(options.turns + 1):  # the first one warms up
        for key, run in runs.items():
            began = time.process_time()
            samples = run()
            if turn:
                cost[key].append((time.process_time() - began) / samples * 1e6)
        gc.collect()
    print(f"seed {options.seed}, medians of {options.turns} turns, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(f"load {os.getloadavg()[0]:.1f} at the end")
    print(f"{'us per sample, by filters':46}" + "".join(f"{filters:9}" for filters in options.filters))
    for name in dict.fromkeys(name for name, filters in cost if filters):
        medians = [statistics.median(cost[name, filters]) for filters in options.filters]
        print(f"{name:46}" + "".join(f"{median:9.2f}" for median in medians))
    pairs = [(cost["windowed, onnxruntime", each], cost["streaming", each]) for each in options.filters]
    ratios = [statistics.median(a / b for a, b in zip(*pair, strict=True)) for pair in pairs]
    print(f"{'windowed, onnxruntime : streaming':46}" + "".join(f"{ratio:9.0f}" for ratio in ratios))
    print_live_path({key: statistics.median(found) for key, found in cost.items()}, options.filters)


def print_live_path(cost: dict[tuple[str, int], float], filters: Sequence[int]) -> None:
    """Print the cost of each operator of one fingertip, by filters."""
    scores = "live, through Score"
    for each in filters:
        costs = {"Zero": cost["Zero", 0], "Score": cost[scores, each], "Debounce": cost["Debounce", 0]}
        print(f"us per sample, live, {each} filters")
        for name, value in {**costs, "all": sum(costs.values())}.items():
            print(f"{name:46}{value:9.2f}")


if __name__ == "__main__":
    main()

"""Speed against accuracy of `tcn` by its size, on simulated strokes, real recordings and random held objects.

Trains the sizes that the folder lacks, with the recipe of the shipped network `tcn` (24 filters, 2 s), then
judges all of them. Real recordings and the trace judge only: no setting may be chosen by them.
"""

import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSink, TestSource
from flows.lab.experiments.study import Method
from flows.learn.evaluation.evaluation_study import evaluate
from flows.learn.measures import SAMPLES, SHARES
from flows.learn.training.recipe import Recipe
from flows.learn.training.trainer import train
from flows.report.figures import FAINT, MAIN, WIDTH, Figure, grid, svg
from flows.report.results import estimates
from flows.report.table import Table
from operators import Debounce, Score, Touch, Zero, ms
from operators.detectors import Detector
from storage import load_detector
from tests.benchmarks.machine import print_head, take_turns
from tests.scene.tune_experiments import success_rates

LONG, SHORT = (1, 2, 4, 8), (1, 2, 4)  # dilations whose window is 2 s and 1 s
SIZES: Final = {
    "tcn": Recipe(),
    **{f"tcn_{filters}": Recipe(filters=filters, dilations=LONG) for filters in (4, 8, 16, 32, 48)},
    **{f"tcn_{filters}_1s": Recipe(filters=filters, dilations=SHORT) for filters in (8, 16, 24, 48)},
}
ROWS, TURNS = 2000, 15  # of one fingertip
COST: Final = "us/sample"
STATISTICS: Final = {**SHARES, **SAMPLES}


def trained(name: str, folder: Path, data: Sequence[Path]) -> Path:
    """Return the model file of a size; train it if it is missing."""
    path = folder / f"{name}.safetensors"
    if not path.exists():
        train(data, path, SIZES[name])
    return path


def live_cost(detector: Detector) -> Callable[[], float]:
    """Return a function that pushes single samples through a live flow, and returns the CPU us of one."""
    flow = Flow("live")
    stream: Any = flow.source(TestSource(Touch, fingers=(0,)))
    (stream | Zero() | Score(detector) | Debounce()).to(TestSink())
    compiled, walk = CompiledFlow(flow), np.random.default_rng(0).integers(-20, 21, (ROWS, 6))
    counts = (-250 + np.cumsum(walk, axis=0) % 250).astype(np.int16)
    push = compiled.pusher(*compiled.entries)
    times, valid = np.arange(ROWS) * 10 * ms, np.ones_like(counts, np.bool_)
    rows = Touch(times, counts, counts, valid, finger=0).packed.copy()
    push(Touch.unpack(rows.copy(), 0))
    rows["time"] = rows["time"][-1]  # later turns have one time, so that no row is late
    pieces = [rows[at : at + 1] for at in range(ROWS)]

    def measure() -> float:
        began = time.process_time()
        for row in pieces:
            push(Touch.unpack(row, 0))
        return (time.process_time() - began) / ROWS * 1e6

    return measure


def shares(dataset: Path, split: str, models: Sequence[Path], *metrics: str) -> list[list[float]]:
    """Return metrics of models on a split of a dataset, %: (models, metrics)."""
    found = evaluate(dataset, split=split, names=[*map(str, models)])
    table = estimates(found.results, {name: STATISTICS[name] for name in metrics}, draws=0)
    value = {(row["method"], row["statistic"]): row["value"] for row in table.to_dicts()}
    return [[value[str(model), name] for name in metrics] for model in models]


def held_objects(models: Sequence[Path], trials: int, executor: Executor) -> list[list[float]]:
    """Return the strict success with random validation objects, %: (models, tap and lift).

    Each model has the threshold that is best for it.
    """
    rates, best = success_rates([Method(str(model)) for model in models], trials, executor)
    return [[float(rate[place, best[place]]) for rate in rates] for place in range(len(models))]


def chart(table: Table) -> Figure:
    """Draw each measure over the cost: windows of 2 s filled, of 1 s hollow."""
    heads = [name for name in table.head[1:] if name != COST]
    figure, axes = grid(-(-len(heads) // 4), 4, (WIDTH, 2.4 * -(-len(heads) // 4)))
    for axis, head in zip(axes, heads, strict=False):
        for row in table.rows:
            values: Any = dict(zip(table.head, row, strict=True))
            size = SIZES[values["network"]]
            colour, at = MAIN if values["network"] == "tcn" else FAINT, (values[COST], values[head])
            axis.plot(*at, "o", color=colour, fillstyle="full" if size.dilations == LONG else "none")
            axis.annotate(str(size.filters), at, (4, 2), textcoords="offset points", fontsize=8)
        axis.set(title=head, xlabel="us per sample")
        axis.grid(visible=True)
    for axis in axes[len(heads) :]:
        axis.set_axis_off()
    return figure


def judged(given: Namespace, executor: Executor) -> Table:
    """Train what is missing, and return the table of all sizes."""
    jobs = [executor.submit(trained, size, given.folder, given.train) for size in SIZES]
    models = [job.result() for job in jobs]
    costs = take_turns({model.stem: live_cost(load_detector(str(model))) for model in models}, TURNS)
    paper = shares(given.paper, "test", models, "accuracy %")
    strokes = shares(given.strokes, "all", models, "balanced %", "AUC %")
    grasps = shares(given.grasps, "all", models, "AUC %")
    trace = shares(given.trace, "all", models, "balanced %")
    held = held_objects(models, given.trials, executor)
    head = [
        "network",
        COST,
        "paper plan %",
        "strokes %",
        "strokes AUC %",
        "grasps AUC %",
        "trace %",
        "tap %",
        "lift %",
    ]
    rows = [
        [model.stem, median(costs[model.stem]), *(value for part in parts for value in part)]
        for model, *parts in zip(models, paper, strokes, grasps, trace, held, strict=True)
    ]
    return Table(head, rows, decimals={COST: 2})


def main() -> None:
    """Print the table and draw the chart."""
    options = ArgumentParser(prog="python -m tests.benchmarks.bench_sizes", description=__doc__)
    options.add_argument("folder", type=Path, help="folder of the models: tcn, tcn_FILTERS, tcn_FILTERS_1s")
    options.add_argument("--train", type=Path, nargs="+", default=[], help="datasets to train on")
    for name, what in {
        "paper": "dataset of the paper's plan",
        "strokes": "real strokes over surfaces",
        "grasps": "real grasps",
        "trace": "a real trace, imported",
    }.items():
        options.add_argument(f"--{name}", type=Path, required=True, help=what)
    options.add_argument("--trials", type=int, default=60, help="trials of each experiment (default 60)")
    options.add_argument("--out", type=Path, default=Path("sizes.svg"), help="chart (default sizes.svg)")
    given = options.parse_args()
    print_head(f"{given.trials} trials, medians of {TURNS} turns")
    with ProcessPoolExecutor(2, get_context("spawn")) as executor:
        table = judged(given, executor)
    print(table.markdown())
    given.out.write_text(svg(partial(chart, table)))


if __name__ == "__main__":
    main()

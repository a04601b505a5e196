"""Speed against accuracy of sizes of the TCN: `python -m tests.benchmarks.bench_sizes DATASETS --out FOLDER`.

Trains each size on the same datasets with the same number of steps, fewer than the shipped network has. A
size that FOLDER has is not trained again. The table and its figure, FOLDER/sizes.svg, show the cost of a
sample, the accuracy on the test split of the first dataset, the area under the ROC curve on real recordings,
which no network has seen, and the strict success with random validation objects at the threshold that is best
for the size.
"""

from argparse import ArgumentParser
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Final

import numpy as np
from scipy.stats import mannwhitneyu

from flows.lab.experiments.study import EXPERIMENTS, Method
from flows.learn.evaluation.detector_speed import costs
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import label_scores
from flows.learn.training.trainer import train
from flows.report.figures import INK, MAIN, WIDTH, Figure, grid, name_points, svg
from flows.report.table import Table, Value
from operators.batch import SLIP, STATIC
from operators.detectors import Detector
from storage import load_detector
from tests.benchmarks.machine import print_head
from tests.scene.tune_experiments import SEED, successes

SIZES: Final = {  # filters and dilations; the window follows
    "4, 2 s": (4, (1, 2, 4, 8)),
    "8, 2 s": (8, (1, 2, 4, 8)),
    "16, 2 s": (16, (1, 2, 4, 8)),
    "24, 1 s": (24, (1, 2, 4)),
    "24, 2 s": (24, (1, 2, 4, 8)),
    "48, 2 s": (48, (1, 2, 4, 8)),
}


def trained(datasets: Sequence[Path], folder: Path, steps: int, name: str) -> Path:
    """Train a size unless its file exists; return the file."""
    filters, dilations = SIZES[name]
    path = folder / f"tcn_{name.replace(', ', '_').replace(' ', '')}.safetensors"
    if not path.exists():
        train(datasets, path, Recipe(filters=filters, dilations=dilations, steps=steps))
    return path


def auc(detector: Detector, recordings: Sequence[LabelledRecording]) -> float:
    """Return the area under the ROC curve of all samples that have a label and a score, %."""
    found = [(each.probabilities(detector), each.label) for each in recordings]
    probability, label = (np.concatenate(each) for each in zip(*found, strict=True))
    slip, static = (probability[(label == each) & ~np.isnan(probability)] for each in (SLIP, STATIC))
    return 100 * float(mannwhitneyu(slip, static).statistic) / (len(slip) * len(static))


def draw(columns: Sequence[str], rows: Sequence[Sequence[Value]]) -> Figure:
    """Draw each measure over the cost of a sample."""
    figure, axes = grid(1, len(columns) - 2, (WIDTH, 3.2))
    for place, axis in enumerate(axes, start=2):
        points = [(str(row[0]), float(row[1] or 0), float(row[place] or 0)) for row in rows]
        axis.plot(*zip(*[each[1:] for each in points], strict=True), "o", color=MAIN, markerfacecolor=INK)
        axis.set(xlabel="us per sample", title=columns[place], xlim=(0, 1.6 * max(us for _, us, _ in points)))
        axis.grid(visible=True)
        name_points(axis, points, (1.6, 2.3))
    return figure


def main() -> None:
    """Train, measure and print the table."""
    options = ArgumentParser(description=__doc__)
    options.add_argument(
        "datasets", type=Path, nargs="+", help="datasets to train on; the first one is the test, too"
    )
    options.add_argument("--out", type=Path, required=True, help="folder of networks and figure")
    options.add_argument("--steps", type=int, default=2000, help="steps of the training (default 2000)")
    options.add_argument("--trials", type=int, default=48, help="trials of each experiment (default 48)")
    options.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    options.add_argument("--real", type=Path, nargs="*", default=[], help="datasets of real recordings")
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    print_head(f"sizes of the TCN, {given.steps} steps of training")
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        paths = [*pool.map(partial(trained, given.datasets, given.out, given.steps), SIZES)]
        methods, rates = [Method(str(path)) for path in paths], list[np.ndarray]()
        for experiment in EXPERIMENTS:
            tasks = [(experiment, SEED + number) for number in range(given.trials)]
            rates.append(100 * np.mean([*pool.map(partial(successes, methods), tasks)], axis=0))
    best = np.argmax(np.mean(rates, axis=0), axis=1)  # (sizes,)
    detectors = {name: load_detector(path) for name, path in zip(SIZES, paths, strict=True)}
    test = [each for each in load(given.datasets[0]) if each.split == "test"]
    real = {f"AUC % {path.name}": load(path) for path in given.real}
    cost = costs(detectors, max(test, key=len).counts[-500:])
    columns = ["filters, window", "us/sample", f"accuracy % {given.datasets[0].name}", *real]
    columns += [f"{experiment} %" for experiment in EXPERIMENTS]
    rows: list[list[Value]] = [
        [
            name,
            cost[name],
            label_scores(detector, test)["accuracy"],
            *(auc(detector, recordings) for recordings in real.values()),
            *(float(rate[place, best[place]]) for rate in rates),
        ]
        for place, (name, detector) in enumerate(detectors.items())
    ]
    print(Table(columns, rows).markdown())
    (given.out / "sizes.svg").write_text(svg(lambda: draw(columns, rows)))


if __name__ == "__main__":
    main()

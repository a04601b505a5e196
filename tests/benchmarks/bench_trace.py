"""Balanced accuracy of models on a labelled real trace, and the mean of their seeds.

The trace judges models that are already trained. No setting may be chosen by this table.
"""

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from flows.learn.training.trained_model import label_scores
from flows.report.table import Table, Value
from storage import load_detector
from tests.benchmarks.machine import commit
from tests.scene.scene_targets import read_trace


def table(trace: Path, models: Sequence[Path]) -> Table:
    """Return the scores of each model on the trace, and their mean."""
    recording = read_trace(trace)
    scores = [label_scores(load_detector(model), [recording]) for model in models]
    rows: list[list[Value]] = [
        [model.stem, each["balanced"], each["accuracy"]] for model, each in zip(models, scores, strict=True)
    ]
    means = (float(np.mean([each[name] for each in scores])) for name in ("balanced", "accuracy"))
    return Table(["model", "balanced %", "accuracy %"], [*rows, ["mean", *means]])


def main() -> None:
    """Print the table."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("trace", type=Path, help="CSV trace with a label in each row")
    options.add_argument("models", type=Path, nargs="+", help="model files, such as the seeds of one network")
    given = options.parse_args()
    print(f"{given.trace.stem}, commit {commit()}\n\n{table(given.trace, given.models).markdown()}")


if __name__ == "__main__":
    main()

"""Balanced accuracy on real strokes of surfaces: zero-shot, adapted without labels, few-shot, and logistic.

Reads the folder of stroke recordings, one Parquet file each, named SURFACE_velN. A recording's first 30 s
without labels, or about two labelled minutes of a surface, adapt the detector; the other recordings of the
surface judge it. The logistic regression is fitted on the other surfaces.
"""

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
import polars as pl

from flows.learn.adaptation.adapted import adapt
from flows.learn.adaptation.fine_tuning import fine_tune
from flows.learn.evaluation.baselines import Logistic
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import labels, windows
from flows.learn.training.trained_model import label_scores
from operators.detectors import Detector, Tcn
from operators.errors import InputError
from storage import load_detector
from tests.benchmarks.machine import commit, machine

RATE = 100  # Hz
HOP = 5  # samples between the windows that fit the regression


def strokes(folder: Path) -> dict[str, list[LabelledRecording]]:
    """Return the recordings of each surface."""
    found = dict[str, list[LabelledRecording]]()
    for path in sorted(folder.glob("*_vel*.parquet")):
        frame = pl.read_parquet(path)
        counts = frame.select([f"b{cell}" for cell in range(6)]).to_numpy().astype(np.int16)
        label = frame["label"].to_numpy().astype(np.int8)
        surface = path.stem.rpartition("_vel")[0].partition("_vel")[0]
        recording = LabelledRecording(counts, label, surface, name=path.stem, group=surface)
        found.setdefault(surface, []).append(recording)
    return found


def balanced(detector: Detector, recordings: Sequence[LabelledRecording]) -> float:
    """Return the balanced accuracy, %."""
    return label_scores(detector, recordings)["balanced"]


def adapted_to_each(
    tcn: Tcn, recordings: Sequence[LabelledRecording], seconds: float, step: int
) -> tuple[list[float], int, list[float]]:
    """Return accuracies on the other recordings, how often the old network was kept, and times (s)."""
    found, kept, times = list[float](), 0, list[float]()
    for source in recordings[::step]:
        others = [each for each in recordings if each is not source]
        began = perf_counter()
        try:
            adapted = adapt(tcn, [source.piece(slice(round(seconds * RATE)))])
        except InputError as error:
            print(error)
            continue
        times.append(perf_counter() - began)
        kept += not adapted.better
        found.append(balanced(adapted.tcn if adapted.better else tcn, others))
    return found, kept, times


def few_shot(tcn: Tcn, recordings: Sequence[LabelledRecording]) -> float:
    """Return the accuracy after training on two minutes, on the other recordings; NaN if none are left."""
    used = int(np.searchsorted(np.cumsum([len(each) for each in recordings]), 120 * RATE)) + 1
    if used >= len(recordings):
        return float("nan")
    tuned = fine_tune(tcn, recordings[:used])
    return balanced(tuned.tcn if tuned.better else tcn, recordings[used:])


def logistic(others: Sequence[LabelledRecording], recordings: Sequence[LabelledRecording]) -> float:
    """Return the accuracy of the regression that is fitted on the other surfaces."""
    seen = np.concatenate([windows(each, 41, HOP) for each in others])
    return balanced(Logistic.fitted(seen, labels(others, HOP)), recordings)


def main() -> None:
    """Measure and print the table."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--model", default="tcn")
    options.add_argument("--seconds", type=float, default=30.0)
    options.add_argument("--step", type=int, default=1, help="adapt to every nth recording only")
    given = options.parse_args()
    surfaces, tcn = strokes(given.folder), load_detector(given.model)
    assert isinstance(tcn, Tcn)
    print(f"{machine()}, seed 0, commit {commit()}, {given.model}; balanced accuracy, %")
    columns = "zero-shot", "adapted", "lowest", "kept old", "s", "few-shot", "logistic"
    print(f"{'':10}" + "".join(f"{each:>10}" for each in columns))
    for surface, recordings in surfaces.items():
        found, kept, times = adapted_to_each(tcn, recordings, given.seconds, given.step)
        rest = [each for other, group in surfaces.items() if other != surface for each in group]
        before, tuned = balanced(tcn, recordings), few_shot(tcn, recordings)
        row = (
            before,
            float(np.mean(found)),
            min(found),
            kept,
            median(times),
            tuned,
            logistic(rest, recordings),
        )
        print(f"{surface:10}" + "".join(f"{each:10.1f}" for each in row), flush=True)


if __name__ == "__main__":
    main()

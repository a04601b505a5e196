"""Errors of direction and speed of true slips, as the velocity head estimates them, on simulated datasets.

`--strokes` adds the error of the speed on real strokes, against that of the joint in the dataset of the
recipe strokes: of each labelled slip of 50 ms or more.
"""

from argparse import ArgumentParser
from pathlib import Path

import numpy as np

from flows.learn.labelled_recordings import load, session_folders
from flows.learn.sampling import WARM_UP
from flows.learn.training.tcn_features import velocities
from flows.learn.training.velocity_scores import mean_velocity, velocity_scores
from operators.batch import Labelled, concat
from operators.detectors import Tcn
from storage import Session, load_detector
from tests.benchmarks.machine import commit

SHORTEST = 5  # samples of a slip that is judged


def print_real_speed(detector: Tcn, dataset: Path) -> None:
    """Print the median error of the speed against the joint, and that of a constant."""
    true, found = list[float](), list[float]()
    for folder in session_folders(dataset):
        speed = concat(Labelled, list(Session.open(folder).read(Labelled, 0))).speed * 1e3  # mm/s
        (recording,) = load(folder)
        estimates = velocities(detector, recording.counts)
        slip = recording.slip.copy()
        slip[:WARM_UP] = False
        edges = np.flatnonzero(np.diff(slip.astype(np.int8), prepend=0, append=0))
        for first, end in edges.reshape(-1, 2).tolist():
            if end - first >= SHORTEST:
                true.append(float(speed[first:end].mean()))
                found.append(float(np.hypot(*mean_velocity(estimates[first:end]))))
    joint, estimated = np.array(true), np.array(found)
    errors = [100 * np.median(np.abs(each - joint) / joint) for each in (estimated, np.median(joint))]
    print(
        f"{dataset.name}: median error of the speed against the joint {errors[0]:.0f} %, of a constant"
        f" {errors[1]:.0f} %; medians {np.median(estimated):.0f} and {np.median(joint):.0f} mm/s, correlation"
        f" {np.corrcoef(estimated, joint)[0, 1]:.2f}; {len(joint)} slips"
    )


def main() -> None:
    """Judge the test split of each dataset, all slips, then those of translations and of rotations."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("datasets", type=Path, nargs="+")
    options.add_argument("--model", default="tcn", help="shipped tcn or file of weights")
    options.add_argument("--strokes", type=Path, help="dataset of the recipe strokes")
    given = options.parse_args()
    detector = load_detector(given.model)
    assert isinstance(detector, Tcn), "only a tcn may have a velocity"
    print(f"{given.model}, commit {commit()}")
    print(
        "| test split | slips | within 45 degrees % | in the first 50 ms % | angle, median | speed error % |"
        " error of a constant % |\n|---|---:|---:|---:|---:|---:|---:|"
    )
    for path in given.datasets:
        test = [each for each in load(path) if each.split == "test"]
        strokes = [each for each in test if each.speed is not None]
        turns = [each for each in test if each.speed is None]
        for name, part in (("", test), (" translations", strokes), (" rotations", turns)):
            if found := velocity_scores(detector, part):
                row = found.direction, found.begin, found.angle, found.speed, found.constant
                shown = " | ".join(f"{value:.1f}" for value in row)
                print(f"| {path.name}{name} | {found.slips} | {shown} |")
    if given.strokes and detector.heads.velocity:
        print_real_speed(detector, given.strokes)


if __name__ == "__main__":
    main()

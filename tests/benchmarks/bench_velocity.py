"""Errors of direction and speed of true slips, as the velocity head estimates them, on simulated datasets."""

from argparse import ArgumentParser
from pathlib import Path

from flows.learn.labelled_recordings import load
from flows.learn.training.velocity_scores import velocity_scores
from storage import load_detector
from tests.benchmarks.machine import commit


def main() -> None:
    """Judge the test split of each dataset, all slips, then those of translations and of rotations."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("datasets", type=Path, nargs="+")
    options.add_argument("--model", default="tcn", help="shipped tcn or file of weights")
    given = options.parse_args()
    detector = load_detector(given.model)
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


if __name__ == "__main__":
    main()

"""What a training set whose clocks are off costs, and what learning the delay saves.

The arm's stamps of the training and validation recordings are shifted by 100 ms, those of the test recordings
are not. ``--lag`` of `slipflow train` shifts each recording's labels to come as late as in a good set.
"""

from argparse import ArgumentParser
from dataclasses import replace
from platform import machine, processor

import numpy as np

from flows.lab.simulation import planned_recordings
from flows.learn.evaluation.sample_metrics import Confusion
from flows.learn.labelled_recordings import LabelledRecording, simulated_recording
from flows.learn.scoring import probabilities
from flows.learn.training.dense_training import train_dense
from flows.learn.training.label_lag import lags, relabelled
from flows.learn.training.recipe import Recipe
from operators.batch import SLIP, UNKNOWN
from operators.detectors import Tcn
from tests.benchmarks.machine import commit

RATE = 100.0  # Hz


def shifted(trials: list[LabelledRecording], seconds: float) -> list[LabelledRecording]:
    """The same with labels that come later."""
    samples = round(seconds * RATE)
    return [replace(each, label=np.roll(each.label, samples)) for each in trials]


def balanced(tcn: Tcn, trials: list[LabelledRecording]) -> float:
    """Balanced accuracy, %."""
    probability = np.concatenate([probabilities(tcn, each) for each in trials])
    label = np.concatenate([each.label for each in trials])
    known = (label != UNKNOWN) & ~np.isnan(probability)
    return Confusion.of(probability[known] > 1 / 2, label[known] == SLIP).balanced


def main() -> None:
    """Train and print the table."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("--steps", type=int, default=1000)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    split: dict[str, list[LabelledRecording]] = {"train": [], "validation": [], "test": []}
    for each in planned_recordings("paper", given.seed):
        split[each.split].append(simulated_recording(each.scene, each.seed, each.session, each.split))
    usual = float(np.median(lags(split["train"])))
    recipe = Recipe(steps=given.steps, checks=4, seed=given.seed)
    print(f"{machine()} {processor()}, seed {given.seed}, {given.steps} steps, commit {commit()}")
    print(f"labels of the plan come {1000 * usual:.0f} ms after the signal\n")
    print("| training labels off by | as they are | with --lag |")
    print("| ---: | ---: | ---: |")
    for off in (0.0, 0.1, -0.1):
        row: list[float] = []
        for learn in (False, True):
            train, validation = (shifted(split[name], off) for name in ("train", "validation"))
            if learn:
                train, validation = relabelled(train, usual), relabelled(validation, usual)
            row.append(balanced(Tcn(train_dense(train, validation, recipe).arrays), split["test"]))
        print(f"| {1000 * off:+.0f} ms | {row[0]:.1f} | {row[1]:.1f} |", flush=True)


if __name__ == "__main__":
    main()

"""Thresholds of the methods of the robot experiments: `python -m tests.scene.tune_experiments`, or `--help`.

Each method runs the trials of random validation objects, which no report uses, at several thresholds. The
best one has the highest mean of both strict success rates; `flows.lab.experiments.study` states it.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flows.lab.experiments.study import EXPERIMENTS, METHODS, Method, parse_method
from flows.lab.experiments.trial import RANDOM, Conditions, Trial
from flows.report.table import Table, Value
from operators.batch import Reals
from tests.benchmarks.machine import commit

SEED: Final = 810_000  # of the first trial
THRESHOLDS: Final = (0.3, 0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 0.97, 0.98, 0.99)


def successes(methods: Sequence[Method], task: tuple[str, int]) -> list[list[bool]]:
    """Run one trial with each method at each threshold; return (methods, thresholds) strict successes."""
    loaded = [method.load() for method in methods]
    setups = [(detector, replace(rule, threshold=t)) for detector, rule in loaded for t in THRESHOLDS]
    found = EXPERIMENTS[task[0]](Trial.draw(RANDOM, task[1], Conditions()), setups)
    return np.reshape([each.success for _, each in found], (len(methods), len(THRESHOLDS))).tolist()


def success_rates(
    methods: Sequence[Method], trials: int, executor: Executor
) -> tuple[list[Reals], NDArray[np.intp]]:
    """Return success (methods, thresholds) % by experiment, and the place of the best one (methods,)."""
    rates = list[Reals]()
    for experiment in EXPERIMENTS:
        tasks = [(experiment, SEED + number) for number in range(trials)]
        rates.append(100 * np.mean([*executor.map(partial(successes, methods), tasks)], axis=0))
    return rates, np.argmax(np.mean(rates, axis=0), axis=1)


def main() -> None:
    """Print the success at each threshold, and the best one."""
    options = argparse.ArgumentParser(prog="python -m tests.scene.tune_experiments", description=__doc__)
    options.add_argument("methods", nargs="*", help="methods, as of `slipflow experiment` (default: four)")
    options.add_argument("--trials", type=int, default=60, help="trials of each experiment (default 60)")
    options.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    given = options.parse_args()
    methods = [parse_method(text) for text in given.methods] or list(METHODS)
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        rates, best = success_rates(methods, given.trials, pool)
    rows: list[list[Value]] = [
        [str(method), name, *map(float, rate[place]), f"{THRESHOLDS[best[place]]:g}"]
        for place, method in enumerate(methods)
        for name, rate in zip(EXPERIMENTS, rates, strict=True)
    ]
    print(f"{given.trials} trials each, seeds from {SEED}, commit {commit()}; strict success, %\n")
    print(Table(["method", "experiment", *(f"{t:g}" for t in THRESHOLDS), "best"], rows).markdown())


if __name__ == "__main__":
    main()

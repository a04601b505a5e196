"""Decision thresholds, tuned on tap trials with objects and fingertips drawn for validation."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Final

import numpy as np

from connectors.sim.drawn_grasp import draw_fingertip, draw_object
from flows.lab.experiments.rivals import Method, load_rival
from flows.lab.experiments.tap_trial import judge_tap, tap_trace
from flows.lab.experiments.trial import FIRM, Conditions, Trace, Trial
from flows.run.executor import map_tasks
from operators import StepGrip
from operators.detectors import Detector

SEED: Final = 800_000  # far from the seeds of training and test
THRESHOLDS: Final = 1 / (1 + np.exp(-np.arange(-4, 8.01, 0.25)))  # tried


def validation_trial(seed: int) -> Trial:
    """Draw a trial with an object and a fingertip of its own, from the ranges of the training grasps.

    Objects that the gripper cannot hold firmly are left out.
    """
    random, conditions = np.random.default_rng([seed, 13]), Conditions()
    while True:
        trial = Trial.draw(draw_object(random), seed, conditions, draw_fingertip(random))
        if trial.least_force * FIRM[1] <= conditions.gripper.span:
            return trial


def tuned(
    methods: Sequence[Method],
    count: int,
    *,
    seed: int = SEED,
    executor: Executor | None = None,
    progress: Callable[[int, int], object] = lambda _done, _total: None,
) -> list[Method]:
    """Tune the threshold of each method on the same tap trials.

    Args:
        methods: Detectors and rules.
        count: Number of trials, each with another object and fingertip.
        seed: Random seed of the first trial.
        executor: Runs the trials; None: this process.
        progress: Called with the number of trials, and their total.

    Returns:
        The methods with their tuned thresholds.
    """
    traces = list(map_tasks(_trace, range(seed, seed + count), executor, progress=progress))
    return [
        replace(method, threshold=best_threshold(load_rival(method.detector), traces)) for method in methods
    ]


def best_threshold(detector: Detector, traces: Sequence[Trace]) -> float:
    """Return the threshold of highest success in tap trials, the middle one of equally good ones."""
    scored = [trace.scored(detector) for trace in traces]
    outcomes = [[judge_tap(each, StepGrip(threshold=t)) for each in scored] for t in THRESHOLDS.tolist()]
    success = np.array([[outcome.success for outcome in row] for row in outcomes]).mean(axis=1)
    best = np.flatnonzero(success == success.max())
    return float(THRESHOLDS[best[len(best) // 2]])


def _trace(seed: int) -> Trace:
    return tap_trace(validation_trial(seed))

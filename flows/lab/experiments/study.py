"""Study of an experiment: each method runs the same trials under each condition, in parallel.

A method is a detector and a rule for the grip force: our detector, and its rivals.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.tap_and_lift import lift, tap
from flows.lab.experiments.trial import RANDOM, Conditions, Outcome, Trace, Trial
from flows.report.results import joined, result_rows
from flows.run.executor import map_tasks
from operators import Grip, GripController, Score, StepGrip
from operators.batch import Counts, Reals
from operators.checks import check_choice
from operators.detectors import Detector
from operators.fingertip import TAKKTILE
from storage import load_debounce, load_detector

SEED: Final = 900_000  # far from the seeds of training data
NOMINAL: Final = "nominal"  # condition
OURS, STEPS, NONE = "ours", "steps", "none"  # rules
RULES: Final = (OURS, STEPS, NONE)
DEFAULT: Final = "tcn"  # detector
# of the methods: tuned on validation grasps by `python -m tests.scene.tune_experiments`
THRESHOLDS: Final[Mapping[str, float]] = {DEFAULT: 0.6, "threshold": 0.8, "psd": 0.3, "paper_tcn": 0.3}
RIVALS: Final = tuple(name for name in THRESHOLDS if name != DEFAULT)

Setup: TypeAlias = tuple[Detector, GripController]
Experiment: TypeAlias = Callable[[Trial, Sequence[Setup]], Sequence[tuple[Trace, Outcome]]]
EXPERIMENTS: Final[Mapping[str, Experiment]] = {"tap": tap, "lift": lift}
STRESS: Final[Mapping[str, Sequence[float]]] = {  # values of each setting that differ from nominal
    "friction": (0.5, 0.75, 1.5, 2),
    "mass": (0.5, 1.5, 2),
    "delay": (0.05, 0.1, 0.2, 0.3),  # s
    "rate": (25, 50, 200),  # Hz
    "stiffness": (0.5, 2, 4),
    "tilt": (0.5, 2, 4),
}


@dataclass(frozen=True)
class StepThreshold:
    """A detector without learning: any cell has moved by more than `threshold` counts in 30 ms."""

    threshold: float = 8.0  # counts, at probability 0.5
    length: int = 4  # samples
    name = "threshold"

    def score(self, windows: Counts | Reals) -> Reals:
        """Return step / (step + threshold) of each window (n, 4, 6), its largest step of a cell; (n,)."""
        step = np.abs(windows[:, -1].astype(np.float64) - windows[:, 0]).max(axis=1)  # (n,) counts
        probability: Reals = step / (step + self.threshold)
        return probability


@dataclass(frozen=True, slots=True)
class Method:
    """A detector and a rule for the grip force.

    Raises:
        ParameterError: if there is no such rule.
    """

    detector: str  # a rival, a detector's name or a model file
    rule: str = OURS

    def __post_init__(self) -> None:
        check_choice("Method", "rule", self.rule, RULES)

    def __str__(self) -> str:
        return f"{self.detector}, {self.rule}"

    def load(self) -> tuple[Detector, GripController]:
        """Return the detector and the controller.

        A detector has the threshold in `THRESHOLDS`, or that of its card.

        Raises:
            InputError: if there is no such detector.
            FingertipError: if it was made for another fingertip than the simulated one.
        """
        name = self.detector
        threshold = THRESHOLDS.get(name) or load_debounce(name).threshold
        detector = StepThreshold() if name == "threshold" else load_detector(name)
        detector = Score(detector).for_fingertip(TAKKTILE).detector
        if self.rule == STEPS:
            return detector, StepGrip(threshold=threshold)
        ours = Grip(threshold=threshold)
        return detector, replace(ours, gain=0.0, margin=0.0) if self.rule == NONE else ours


METHODS: Final = (Method(DEFAULT), *(Method(name, STEPS) for name in RIVALS))  # theirs: the paper's


def parse_method(text: str) -> Method:
    """Return a method from ``DETECTOR`` or ``DETECTOR:RULE``; without a rule, rivals have the paper's.

    Raises:
        ParameterError: on an unknown rule.

    >>> [str(parse_method(text)) for text in ("psd", "psd:none", "mine.safetensors")]
    ['psd, steps', 'psd, none', 'mine.safetensors, ours']
    """
    name, _, rule = text.rpartition(":")
    if name:
        return Method(name, rule)
    return Method(text, STEPS if text in RIVALS else OURS)


@dataclass(frozen=True)
class Trials:
    """The trials of a study: a number of seeds for each of the paper's objects, and random objects.

    Raises:
        ParameterError: on an unknown object.
    """

    count: int = 20  # of each object; as in the paper
    objects: tuple[str, ...] = (*OBJECTS, RANDOM)

    def __post_init__(self) -> None:
        for name in self.objects:
            check_choice("Trials", "object", name, (*OBJECTS, RANDOM))

    def seeds(self, name: str) -> range:
        """Return the seeds of an object; there are as many random trials as with the six objects."""
        return range(SEED, SEED + self.count * (len(OBJECTS) if name == RANDOM else 1))


def conditions_of(experiment: str, *, stress: bool) -> dict[str, Conditions]:
    """Return the nominal condition by name, with `stress` also those that differ from it in one setting.

    The force of a tap is constant, so it has no delay.
    """
    names = [name for name in STRESS if stress and (experiment, name) != ("tap", "delay")]
    varied = {
        f"{name} {value:g}": replace(Conditions(), **{name: value})
        for name in names
        for value in STRESS[name]
    }
    return {NOMINAL: Conditions(), **varied}


def run_study(
    experiment: str,
    methods: Sequence[Method],
    trials: Trials,
    *,
    stress: bool = False,
    executor: Executor | None = None,
    progress: Callable[[int, int], object] = lambda _done, _total: None,
) -> pl.DataFrame:
    """Run an experiment under its conditions, always with the same trials.

    Args:
        experiment: One of `EXPERIMENTS`.
        methods: Detectors and rules.
        trials: Trials to run under each condition with each method.
        stress: Run all conditions of `conditions_of`, not only the nominal one.
        executor: Runs the trials; None: this process.
        progress: Called with the number of trials of all methods, and their total.

    Returns:
        Long table of results (`flows.report.results`): a recording is a trial, its fold the object. Metrics
        are ``trials`` (1), ``success``, ``ending NAME`` (1) and those of the outcome that are known.

    Raises:
        InputError: if there is no such detector.
        ParameterError: on an unknown experiment.
        SlipflowError: if a process ended early.
    """
    check_choice("experiment", "name", experiment, EXPERIMENTS)
    conditions = conditions_of(experiment, stress=stress)
    setups = [method.load() for method in methods]
    tasks = [
        (condition, name, seed)
        for condition in conditions
        for name in trials.objects
        for seed in trials.seeds(name)
    ]
    work = partial(_run, experiment, setups, conditions)
    return joined(
        result_rows(metrics, method=str(method), recording=f"{name}-{seed}", condition=condition, fold=name)
        for (condition, name, seed), found in zip(
            tasks, map_tasks(work, tasks, executor, progress=progress), strict=True
        )
        for method, metrics in zip(methods, found, strict=True)
    )


def _run(
    experiment: str, setups: Sequence[Setup], conditions: Mapping[str, Conditions], task: tuple[str, str, int]
) -> list[dict[str, float]]:
    """Return the metrics of a trial with each method; unknown values are left out."""
    condition, name, seed = task
    outcomes = EXPERIMENTS[experiment](Trial.draw(name, seed, conditions[condition]), setups)
    return [
        {"trials": 1, "success": float(outcome.success), f"ending {outcome.ending}": 1}
        | {name: float(value) for name, value in outcome.metrics.items() if not math.isnan(value)}
        for _, outcome in outcomes
    ]

"""An experiment over objects, detectors, rules and conditions, in parallel, with the same trials for each."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from math import isnan, nan
from typing import Final, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from connectors.sim.objects import OBJECTS, Object, named
from flows.lab.experiments.trial import Conditions, Trace
from flows.lift import grip_controller
from flows.run.processes import one_thread, process_map
from operators import GripController, StepGrip
from operators.checks import check_at_least, check_choice
from operators.detectors import Detector
from storage import load_detector

SEED: Final = 900_000  # far from the seeds of training data
CHUNK: Final = 5  # trials per work unit
OURS, STEPS, NONE = "ours", "steps", "none"  # rules
RULES: Final = (OURS, STEPS, NONE)
DEFAULT: Final = "tcn_grasp"  # detector


class Outcome(Protocol):
    """The outcome of a trial of any experiment."""

    @property
    def ending(self) -> str:
        """Name of the way in which the trial ended."""
        ...

    @property
    def success(self) -> bool:
        """True if the trial went well."""
        ...


Result = TypeVar("Result", bound=Outcome)
Experiment: TypeAlias = Callable[[Object, int, Detector, GripController, Conditions], tuple[Trace, Result]]
Progress: TypeAlias = Callable[[int, int, str], object]  # trials done, trials in all, label of the newest


def ignore_progress(_done: int, _total: int, _label: str) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True)
class Method:
    """A detector and a rule for the grip force.

    Raises:
        ParameterError: if there is no such rule.
    """

    detector: str  # a name or a model file
    rule: str = OURS

    def __post_init__(self) -> None:
        check_choice("Method", "rule", self.rule, RULES)

    def __str__(self) -> str:
        return f"{self.detector}, {self.rule}"

    def controller(self) -> GripController:
        """Return the controller, with the threshold from the detector's model card."""
        ours = grip_controller(self.detector, 0.5)
        if self.rule == STEPS:
            return StepGrip(threshold=ours.threshold)
        return replace(ours, gain=0.0, margin=0.0) if self.rule == NONE else ours


@dataclass(frozen=True, slots=True)
class Trials:
    """The trials of a study: a number of seeds for each object.

    Raises:
        ParameterError: on less than one trial, or an unknown object.
    """

    count: int = 20  # of each object; as in the paper
    seed: int = SEED  # of the first trial; the others follow
    objects: tuple[str, ...] = tuple(OBJECTS)

    def __post_init__(self) -> None:
        check_at_least("Trials", "count", self.count, 1)
        for name in self.objects:
            check_choice("Trials", "object", name, OBJECTS)

    def __str__(self) -> str:
        return f"{self.count} {'trial' if self.count == 1 else 'trials'} of each object"

    @property
    def seeds(self) -> range:
        """The seeds of each object's trials."""
        return range(self.seed, self.seed + self.count)


@dataclass(frozen=True, slots=True)
class Results(Generic[Result]):
    """Outcomes of a study under one set of conditions, by method and object, in the order of the seeds."""

    trials: Trials
    methods: tuple[Method, ...]
    conditions: Conditions
    outcomes: Mapping[tuple[Method, str], Sequence[Result]]

    def of(self, method: Method, name: str = "") -> list[Result]:
        """Return the outcomes of a method with one object, or with all if no name is given."""
        names = (name,) if name else self.trials.objects
        return [outcome for each in names for outcome in self.outcomes[method, each]]

    def success(self, method: Method, name: str) -> float:
        """Return the share of successful trials with an object (%)."""
        outcomes = self.of(method, name)
        return 100 * sum(outcome.success for outcome in outcomes) / len(outcomes)

    def mean(self, method: Method) -> float:
        """Return the mean success over the objects (%)."""
        return sum(self.success(method, name) for name in self.trials.objects) / len(self.trials.objects)

    def failures(self, method: Method, name: str = "") -> Counter[str]:
        """Count the endings of the trials that failed."""
        return Counter(outcome.ending for outcome in self.of(method, name) if not outcome.success)


def run_study(
    experiment: Experiment[Result],
    methods: Sequence[Method],
    conditions: Mapping[str, Conditions],
    trials: Trials,
    *,
    jobs: int | None = None,
    progress: Progress = ignore_progress,
) -> dict[str, Results[Result]]:
    """Run an experiment under several conditions, always with the same trials.

    Args:
        experiment: Runs one trial; `tap` or `lift`.
        methods: Detectors and rules.
        conditions: Conditions by name.
        trials: Trials to run under each condition with each method.
        jobs: Number of processes; None: one per core.
        progress: Called with the number of trials done, their total and a label.

    Returns:
        Results by name of the conditions.

    Raises:
        InputError: if there is no such detector.
        ParameterError: on less than one method, condition or job.
        SlipflowError: if a process ended early.
    """
    sizes = {"methods": len(methods), "conditions": len(conditions), "jobs": 1 if jobs is None else jobs}
    for name, value in sizes.items():
        check_at_least("experiment", name, value, 1)
    setups = {method: (load_detector(method.detector), method.controller()) for method in methods}
    units = [
        _Unit(name, method, held, trials.seeds[first : first + CHUNK])
        for name in conditions
        for method in methods
        for held in trials.objects
        for first in range(0, trials.count, CHUNK)
    ]
    outcomes = {name: dict[tuple[Method, str], list[Result]]() for name in conditions}
    done, total = 0, sum(len(unit.seeds) for unit in units)
    progress(0, total, "")
    with closing(process_map(_Worker(experiment, setups, conditions), units, jobs)) as results:
        for unit, found in zip(units, results, strict=True):
            outcomes[unit.condition].setdefault((unit.method, unit.held), []).extend(found)
            done += len(found)
            progress(done, total, unit.condition or f"{unit.method}: {unit.held}")
    return {name: Results(trials, tuple(methods), each, outcomes[name]) for name, each in conditions.items()}


@dataclass(frozen=True, slots=True)
class _Unit:
    """Trials that one process runs at a time."""

    condition: str
    method: Method
    held: str
    seeds: range


@dataclass(frozen=True, slots=True)
class _Worker(Generic[Result]):
    """Runs the trials of a work unit; sent to the processes."""

    experiment: Experiment[Result]
    setups: Mapping[Method, tuple[Detector, GripController]]
    conditions: Mapping[str, Conditions]

    def __call__(self, unit: _Unit) -> list[Result]:
        held, (detector, rule) = named(unit.held), self.setups[unit.method]
        conditions = self.conditions[unit.condition]
        with one_thread():
            return [self.experiment(held, seed, detector, rule, conditions)[1] for seed in unit.seeds]


def median(values: Sequence[float]) -> float:
    """Return the median of the values that are not NaN; NaN if there are none.

    >>> median([1.0, nan, 2.0])
    1.5
    """
    known = [value for value in values if not isnan(value)]
    return float(np.median(known)) if known else nan

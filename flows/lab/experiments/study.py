"""Study of an experiment: each detector and rule runs the same trials under each condition, in parallel."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Final, TypeAlias

from connectors.sim.objects import OBJECTS, named
from flows.lab.experiments.lift_trial import lift
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.tap_trial import tap
from flows.lab.experiments.trial import Conditions, Outcome, Trace, Trial
from flows.run.executor import map_tasks
from operators import GripController
from operators.checks import check_at_least, check_choice
from operators.detectors import Detector

if TYPE_CHECKING:
    import polars as pl

SEED: Final = 900_000  # far from the seeds of training data
NOMINAL: Final = "nominal"  # condition

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
) -> "pl.DataFrame":
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
        ParameterError: on less than one method, or an unknown experiment.
        SlipflowError: if a process ended early.
    """
    from flows.report.results import joined, result_rows

    check_choice("experiment", "name", experiment, EXPERIMENTS)
    check_at_least("experiment", "methods", len(methods), 1)
    conditions = conditions_of(experiment, stress=stress)
    setups = [method.load() for method in methods]
    seeds = range(trials.seed, trials.seed + trials.count)
    tasks = list(product(conditions, trials.objects, seeds))
    work = partial(_run, experiment, setups, conditions)
    return joined(
        result_rows(
            _metrics(outcome),
            method=str(method),
            recording=f"{name}-{seed}",
            condition=condition,
            fold=name,
        )
        for (condition, name, seed), outcomes in zip(
            tasks, map_tasks(work, tasks, executor, progress=progress), strict=True
        )
        for method, outcome in zip(methods, outcomes, strict=True)
    )


def _run(
    experiment: str,
    setups: Sequence[Setup],
    conditions: Mapping[str, Conditions],
    task: tuple[str, str, int],
) -> list[Outcome]:
    condition, name, seed = task
    trial = Trial.draw(named(name), seed, conditions[condition])
    return [outcome for _, outcome in EXPERIMENTS[experiment](trial, setups)]


def _metrics(outcome: Outcome) -> dict[str, float]:
    """Return the metrics of a trial; unknown values are left out."""
    known = {name: float(value) for name, value in outcome.metrics.items() if not math.isnan(value)}
    return {"trials": 1, "success": float(outcome.success), f"ending {outcome.ending}": 1, **known}

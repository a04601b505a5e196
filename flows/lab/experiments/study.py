"""Study of an experiment: each detector and rule runs the same trials under each condition, in parallel."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from connectors.sim.objects import OBJECTS, named
from flows.lab.experiments.gripper_model import GripperModel
from flows.lab.experiments.lift_trial import LiftOutcome, lift
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.tap_trial import TapOutcome, tap
from flows.lab.experiments.trial import Conditions, Trace, Trial
from flows.run.executor import map_tasks
from operators import GripController
from operators.checks import check_at_least, check_choice
from operators.detectors import Detector

if TYPE_CHECKING:
    import polars as pl

SEED: Final = 900_000  # far from the seeds of training data
NOMINAL: Final = "nominal"  # condition

Outcome: TypeAlias = TapOutcome | LiftOutcome
Setup: TypeAlias = tuple[Detector, GripController]
Experiment: TypeAlias = Callable[[Trial, Sequence[Setup]], Sequence[tuple[Trace, Outcome]]]
EXPERIMENTS: Final[Mapping[str, Experiment]] = {"tap": tap, "lift": lift}


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


def _factors(name: str, *factors: float) -> dict[str, Conditions]:
    """Return a condition for each factor of a setting, which is nominal at 1."""
    values: dict[float, Mapping[str, Any]] = {factor: {name: factor} for factor in factors}
    return {f"x{factor:g}": Conditions(**values[factor]) for factor in factors}


AXES: Final[Mapping[str, Mapping[str, Conditions]]] = {  # nominal comes after those below it
    "friction": _factors("friction", 0.5, 0.75, 1, 1.5, 2),
    "mass": _factors("mass", 0.5, 1, 1.5, 2),
    "latency": {
        f"+{delay} ms": Conditions(gripper=replace(GripperModel(), delay=delay / 1000))
        for delay in (0, 50, 100, 200, 300)
    },
    "rate": {f"{rate:g} Hz": Conditions(rate=rate) for rate in (25.0, 50.0, 100.0, 200.0)},
    "stiffness": _factors("stiffness", 0.5, 1, 2, 4),
    "pad": _factors("tilt", 0.5, 1, 2, 4),
}


def axes_of(experiment: str) -> Mapping[str, Mapping[str, Conditions]]:
    """Return the axes of an experiment; the force of a tap is constant, so it has no latency."""
    return {name: each for name, each in AXES.items() if experiment == "lift" or name != "latency"}


def conditions_of(experiment: str, *, stress: bool) -> dict[str, Conditions]:
    """Return the nominal condition by name, with `stress` also those that differ from it in one setting."""
    varied = {
        f"{axis} {value}": each
        for axis, values in axes_of(experiment).items()
        for value, each in values.items()
        if stress and each != Conditions()
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
        are ``trials`` (1), ``success``, ``ending NAME`` (1) and the fields of the outcome that are known.

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
    numbers = {name: float(value) for name, value in asdict(outcome).items() if name != "ending"}
    known = {name: value for name, value in numbers.items() if not math.isnan(value)}
    return {"trials": 1, "success": float(outcome.success), f"ending {outcome.ending}": 1, **known}

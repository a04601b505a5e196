"""Study of an experiment: each detector and rule runs the same trials under each condition, in parallel."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from connectors.sim.objects import OBJECTS, named
from flows.lab.experiments.lift_trial import LiftOutcome
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.tap_trial import TapOutcome
from flows.lab.experiments.trial import Conditions, Trace, Trial
from flows.report.table import counted
from flows.run.executor import process_map
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
Progress: TypeAlias = Callable[[int, int, str], object]  # outcomes so far, all outcomes, newest condition


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
        return f"{counted(self.count, 'trial')} of each object"


@dataclass(frozen=True)
class Study:
    """A finished study.

    Attributes:
        experiment: Function that runs a trial of all methods; `tap` or `lift`.
        methods: Detectors and rules; reports are above all about the first one.
        trials: Trials of each method under each condition.
        outcomes: Row per trial: condition, method, object, seed, success and the fields of the outcome;
            unknown numbers are null.
    """

    experiment: Experiment
    methods: Sequence[Method]
    trials: Trials
    outcomes: "pl.DataFrame"

    @property
    def name(self) -> str:
        """Name of the experiment, ``tap`` or ``lift``."""
        return self.experiment.__name__

    def of(self, method: Method) -> "pl.DataFrame":
        """Return the outcomes of a method."""
        return self.outcomes.filter(method=str(method))


def run_study(
    experiment: Experiment,
    methods: Sequence[Method],
    trials: Trials,
    conditions: Mapping[str, Conditions] | None = None,
    *,
    jobs: int | None = None,
    progress: Progress = lambda _done, _total, _label: None,
) -> Study:
    """Run an experiment under several conditions, always with the same trials.

    Args:
        experiment: Runs one trial of all methods; `tap` or `lift`.
        methods: Detectors and rules.
        trials: Trials to run under each condition with each method.
        conditions: Conditions by name; None: nominal conditions.
        jobs: Number of processes; None: one per core.
        progress: Called with the number of outcomes, their total and the condition of the newest.

    Raises:
        InputError: if there is no such detector.
        ParameterError: on less than one method, condition or job.
        SlipflowError: if a process ended early.
    """
    import polars as pl  # noqa: PLC0415 - slow to import, and of no use to the processes

    tried = {NOMINAL: Conditions()} if conditions is None else conditions
    sizes = {"methods": len(methods), "conditions": len(tried), "jobs": 1 if jobs is None else jobs}
    for name, value in sizes.items():
        check_at_least("experiment", name, value, 1)
    setups = [method.load() for method in methods]
    seeds = range(trials.seed, trials.seed + trials.count)
    units = list(product(tried, trials.objects, seeds))
    rows, total = list[dict[str, Any]](), len(units) * len(methods)
    progress(0, total, "")
    with closing(process_map(partial(_run, experiment, setups, tried), units, jobs)) as found:
        for (condition, name, seed), outcomes in zip(units, found, strict=True):
            for method, outcome in zip(methods, outcomes, strict=True):
                key = {"condition": condition, "method": str(method), "object": name, "seed": seed}
                rows.append({**key, "success": outcome.success, **asdict(outcome)})
            progress(len(rows), total, condition)
    frame = pl.DataFrame(rows, infer_schema_length=None).fill_nan(None)
    return Study(experiment, methods, trials, frame)


def _run(
    experiment: Experiment,
    setups: Sequence[Setup],
    conditions: Mapping[str, Conditions],
    unit: tuple[str, str, int],
) -> list[Outcome]:
    condition, name, seed = unit
    trial = Trial.draw(named(name), seed, conditions[condition])
    return [outcome for _, outcome in experiment(trial, setups)]

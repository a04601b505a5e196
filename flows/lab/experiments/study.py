"""Study of an experiment: each detector and rule runs the same trials under each condition, in parallel."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from connectors.sim.objects import OBJECTS, Object, named
from flows.lab.experiments.lift_trial import LiftOutcome
from flows.lab.experiments.tap_trial import TapOutcome
from flows.lab.experiments.trial import Conditions, Trace
from flows.lift import grip_controller
from flows.run.processes import process_map
from operators import GripController, StepGrip
from operators.checks import check_at_least, check_choice
from operators.detectors import Detector
from storage import load_detector

if TYPE_CHECKING:
    import polars as pl

SEED: Final = 900_000  # far from the seeds of training data
OURS, STEPS, NONE = "ours", "steps", "none"  # rules
RULES: Final = (OURS, STEPS, NONE)
DEFAULT: Final = "tcn_grasp"  # detector
NOMINAL: Final = "nominal"  # condition

Experiment: TypeAlias = Callable[
    [Object, int, Detector, GripController, Conditions], tuple[Trace, TapOutcome | LiftOutcome]
]
Progress: TypeAlias = Callable[[int, int, str], object]  # trials done, trials in all, label of the newest


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


@dataclass(frozen=True)
class Study:
    """A finished study.

    Attributes:
        experiment: Function that runs a trial; `tap` or `lift`.
        methods: Detectors and rules; reports are above all about the first one.
        trials: Trials of each method under each condition.
        outcomes: Row per trial: condition, method, object, seed, success and the fields of the outcome;
            unknown numbers are null.
    """

    experiment: Experiment
    methods: Sequence[Method]
    trials: Trials
    outcomes: "pl.DataFrame"

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
        experiment: Runs one trial; `tap` or `lift`.
        methods: Detectors and rules.
        trials: Trials to run under each condition with each method.
        conditions: Conditions by name; None: nominal conditions.
        jobs: Number of processes; None: one per core.
        progress: Called with the number of trials done, their total and a label.

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
    setups = {method: (load_detector(method.detector), method.controller()) for method in methods}
    seeds = range(trials.seed, trials.seed + trials.count)
    units = list(product(tried, methods, trials.objects, seeds))
    rows = list[dict[str, Any]]()
    progress(0, len(units), "")
    with closing(process_map(partial(_run, experiment, setups, tried), units, jobs)) as found:
        for (condition, method, name, seed), outcome in zip(units, found, strict=True):
            key = {"condition": condition, "method": str(method), "object": name, "seed": seed}
            rows.append({**key, "success": outcome.success, **asdict(outcome)})
            progress(len(rows), len(units), f"{condition}: {method}")
    outcomes = pl.DataFrame(rows, infer_schema_length=None).fill_nan(None)
    return Study(experiment, methods, trials, outcomes)


def _run(
    experiment: Experiment,
    setups: Mapping[Method, tuple[Detector, GripController]],
    conditions: Mapping[str, Conditions],
    unit: tuple[str, Method, str, int],
) -> TapOutcome | LiftOutcome:
    condition, method, name, seed = unit
    return experiment(named(name), seed, *setups[method], conditions[condition])[1]

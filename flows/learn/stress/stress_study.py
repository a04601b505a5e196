"""`slipflow stress`: every detector along every stress field of the simulation, from nominal to broken.

All conditions are simulated with the same seed, so that recordings differ only by the stress. Detectors are
compared with the label by arm speed, and with the true sliding of the contact: a stress of the motion stream
changes the label alone.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from connectors.sim.paper_plan import PaperPlan as Plan
from flows.learn.evaluation.debounce_tuning import tuned_on
from flows.learn.evaluation.event_metrics import Performance, performances
from flows.learn.evaluation.methods import trained_methods, with_baselines
from flows.learn.evaluation.sample_metrics import percent
from flows.learn.labelled_recordings import Target, simulated_recordings
from flows.learn.sampling import WARM_UP
from flows.learn.scoring import probabilities
from flows.learn.stress.stress_fields import FIELDS, breaking_point, plan_of, stressed
from flows.run.executor import one_thread, process_map
from operators import Debounce
from operators.batch import Flags
from operators.checks import check_at_least
from operators.detectors.detector import Detector
from operators.extras import require_extra

PLAN: Final = Plan(repeats=1, rotations=1)  # 16 recordings, 5 minutes
TRAINING: Final = Plan(repeats=3, rotations=1)  # 40 recordings, 14 minutes
SEED: Final = 4000
_FITTING: Final = 1000  # added to the seed for the recordings that baselines are fitted to
_TUNING: Final = 2000  # added to the seed for the recordings that the debounce is tuned on

Progress: TypeAlias = Callable[[int, int], object]
Condition: TypeAlias = tuple[str, float]  # stress field and its value


@dataclass(frozen=True, slots=True)
class Outcome:
    """Performance of all detectors under one condition."""

    degraded: float  # % of samples during which `Health` reports a fault
    unscored: Mapping[str, float]  # % of samples, by detector
    performance: Mapping[tuple[str, Target], Performance]  # by detector


@dataclass(frozen=True, slots=True)
class Stress:
    """Performance of all detectors under all conditions."""

    names: tuple[str, ...]  # of the detectors
    seed: int
    recordings: int  # of each condition
    debounce: Mapping[str, Debounce]  # by detector
    missing: Mapping[str, str]  # reasons by method
    outcomes: Mapping[Condition, Outcome]

    def at(self, name: str, field: str, value: float, target: Target = "arm-speed") -> Performance:
        """Return the performance of one detector under one condition."""
        return self.outcome(field, value).performance[name, target]

    def outcome(self, field: str, value: float) -> Outcome:
        """Return the performance of all detectors under one condition."""
        return self.outcomes[field, value]

    def breaking(self, name: str, field: str, target: Target = "arm-speed") -> dict[str, float | None]:
        """Return the breaking point on each side of nominal; None: not reached."""
        return {
            side: breaking_point(values, [self.at(name, field, value, target).balanced for value in values])
            for side, values in FIELDS[field].sides.items()
        }


def stress(
    models: Sequence[Path] = (),
    *,
    names: Collection[str] = (),
    seed: int = SEED,
    plan: Plan = PLAN,
    training: Plan = TRAINING,
    jobs: int | None = None,
    log: Callable[[str], object] = lambda _: None,
    progress: Progress = lambda _done, _all: None,
) -> Stress:
    """Evaluate all methods under every stress.

    Args:
        models: Files of weights to include.
        names: Only these methods, and those of `models`; empty: all.
        seed: Seed of the recordings.
        plan: Recordings of each condition.
        training: Plan of the nominal recordings, of other seeds, for fitting the baselines and tuning the
            debounce of methods without a card.
        jobs: Number of processes; None: one per core.
        log: Receives progress messages.
        progress: Called with the number of conditions done, and of all.

    Raises:
        InputError: if the train extra is missing, or a method or model does not exist.
        ParameterError: if the seed is negative or `jobs` is below 1.
        SlipflowError: if a process ended early.
    """
    require_extra("train", "stress")
    check_at_least("stress", "seed", seed, 0)
    if jobs is not None:
        check_at_least("stress", "jobs", jobs, 1)
    trained = trained_methods(models, names)
    fitting = simulated_recordings(training, seed + _FITTING)
    nominal = simulated_recordings(training, seed + _TUNING)
    detectors = dict[str, tuple[Detector, Debounce]]()
    with one_thread():
        chosen, missing = with_baselines(trained, fitting, names, log)
        for method in chosen:
            debounce = method.debounce
            if debounce is None:
                log(f"tuning {method.name}")
                debounce = tuned_on(nominal, method.detector)
            detectors[method.name] = method.detector, debounce
    return run_stress(detectors, missing, seed, plan, jobs=jobs, progress=progress)


def run_stress(
    detectors: Mapping[str, tuple[Detector, Debounce]],
    missing: Mapping[str, str],
    seed: int,
    plan: Plan,
    *,
    jobs: int | None = None,
    progress: Progress = lambda _done, _all: None,
) -> Stress:
    """Evaluate detectors with their debounce under every stress; see `stress`."""
    conditions = [(field, value) for field, grid in FIELDS.items() for value in grid.values]
    distinct = list(dict.fromkeys(map(_distinct, conditions)))
    progress(0, len(distinct))
    outcomes: dict[Condition, Outcome] = {}
    with closing(process_map(partial(_outcome, detectors, plan, seed), distinct, jobs)) as each:
        for done, (condition, outcome) in enumerate(zip(distinct, each, strict=True), 1):
            outcomes[condition] = outcome
            progress(done, len(distinct))
    return Stress(
        tuple(detectors),
        seed,
        sum(1 for _ in plan.scenes(seed)),
        {name: debounce for name, (_, debounce) in detectors.items()},
        missing,
        {condition: outcomes[_distinct(condition)] for condition in conditions},
    )


@one_thread()
def _outcome(
    detectors: Mapping[str, tuple[Detector, Debounce]], plan: Plan, seed: int, condition: Condition
) -> Outcome:
    field, value = condition
    recordings = simulated_recordings(plan_of(field, plan), seed, lambda scene: stressed(scene, field, value))
    unscored, performance = dict[str, float](), dict[tuple[str, Target], Performance]()
    for name, (detector, debounce) in detectors.items():
        scores = [probabilities(detector, recording) for recording in recordings]
        unscored[name] = _share([np.isnan(score)[WARM_UP:] for score in scores])
        for target, found in performances(recordings, scores, debounce).items():
            performance[name, target] = found
    degraded = [each.degraded[WARM_UP:] for each in recordings if each.degraded is not None]
    return Outcome(_share(degraded), unscored, performance)


def _distinct(condition: Condition) -> Condition:
    """Return the condition that gives the same recordings: the nominal value is the same in every field."""
    field, value = condition
    if value != FIELDS[field].values[0] or field == "slip_speed":
        return condition
    first = next(iter(FIELDS))
    return first, FIELDS[first].values[0]


def _share(flags: Sequence[Flags]) -> float:
    return percent(sum(int(each.sum()) for each in flags), sum(map(len, flags)))

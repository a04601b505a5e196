"""Stability where methods fail: every detector along every stress field, from nominal to broken.

Each condition is simulated anew with the same seed, so that recordings differ in nothing but the stress. What
a detector says is held against the label by the arm's speed, and against what the contact truly did: a stress
of the motion stream moves the label alone.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Final

import numpy as np

from connectors.sim.paper_plan import PaperPlan as Plan
from connectors.sim.stress_profiles import stressed
from flows.learn.evaluation.debounce_tuning import tuned
from flows.learn.evaluation.event_metrics import Slips
from flows.learn.evaluation.judgement import TRUTHS, Judgement, Truth
from flows.learn.evaluation.methods import methods
from flows.learn.evaluation.sample_metrics import percent
from flows.learn.labelled_recordings import WARM_UP, LabelledRecording, simulated_recordings
from flows.learn.scoring import probabilities
from flows.learn.stress.stress_fields import GRIDS, plan_of
from flows.learn.stress.stress_result import Condition, Outcome, Stress
from flows.run.processes import one_thread, process_map
from operators import Debounce
from operators.batch import Flags
from operators.detectors.detector import Detector
from operators.errors import ParameterError

PLAN: Final = Plan(repeats=1, rotations=1)  # 16 recordings, 5 minutes
TRAINING: Final = Plan(repeats=3, rotations=1)  # 40 recordings, 14 minutes
SEED: Final = 4000
_FITTING: Final = 1000  # from the seed that is judged to the one that simple detectors are fitted to
_TUNING: Final = 2000  # and to the one that debouncing is tuned on


def stress(
    models: Sequence[Path] = (),
    *,
    names: Collection[str] = (),
    seed: int = SEED,
    plan: Plan = PLAN,
    training: Plan = TRAINING,
    jobs: int | None = None,
    told: Callable[[str], object] = lambda _: None,
    progress: Callable[[int, int], object] = lambda _done, _all: None,
) -> Stress:
    """Judge all methods under every stress.

    Args:
        models: files of weights to judge as well.
        names: of the methods that are judged; empty: all.
        seed: Of the recordings.
        plan: What is recorded under each condition.
        training: Nominal recordings, of other seeds: what simple detectors are fitted to, and what
            debouncing is tuned on where a model's card does not say how.
        jobs: Processes; None: one for each of the machine's cores.
        told: Is told what is being done, and what is skipped.
        progress: Told how many conditions are done, of how many.

    Raises:
        InputError: if there is no such method or model.
        ParameterError: on a negative seed, or less than one job.
        SlipflowError: if a process ended early.
    """
    if seed < 0:
        raise ParameterError("stress", "seed", seed, "0 or above")
    if jobs is not None and jobs < 1:
        raise ParameterError("stress", "jobs", jobs, "1 or above")
    fitting, nominal = (
        simulated_recordings(training, seed + _FITTING),
        simulated_recordings(training, seed + _TUNING),
    )
    subjects = dict[str, tuple[Detector, Debounce]]()
    with one_thread():
        chosen, missing = methods(fitting, models, names, told)
        for name, reason in missing.items():
            told(f"SKIPPED: {name}, because {reason}")
        for method in chosen:
            debounce = method.debounce
            if debounce is None:
                told(f"tuning {method.name}")
                debounce = _tuned(method.detector, nominal)
            subjects[method.name] = method.detector, debounce
    return judged(subjects, missing, seed, plan, jobs=jobs, progress=progress)


def judged(
    subjects: Mapping[str, tuple[Detector, Debounce]],
    missing: Mapping[str, str],
    seed: int,
    plan: Plan,
    *,
    jobs: int | None = None,
    progress: Callable[[int, int], object] = lambda _done, _all: None,
) -> Stress:
    """Judge detectors, debounced, under every stress; see `stress`."""
    began = perf_counter()
    conditions = [Condition(field, value) for field, grid in GRIDS.items() for value in grid.values]
    distinct = list(dict.fromkeys(map(_distinct, conditions)))
    progress(0, len(distinct))
    outcomes: dict[Condition, Outcome] = {}
    with closing(process_map(_Judge(subjects, plan, seed), distinct, jobs)) as each:
        for done, (condition, outcome) in enumerate(zip(distinct, each, strict=True), 1):
            outcomes[condition] = outcome
            progress(done, len(distinct))
    return Stress(
        tuple(subjects),
        seed,
        sum(1 for _ in plan.scenes(seed)),
        {name: debounce for name, (_, debounce) in subjects.items()},
        missing,
        {condition: outcomes[_distinct(condition)] for condition in conditions},
        perf_counter() - began,
    )


@dataclass(frozen=True, slots=True)
class _Judge:
    """Simulates a condition and judges all detectors; goes to processes."""

    subjects: Mapping[str, tuple[Detector, Debounce]]
    plan: Plan
    seed: int

    def __call__(self, condition: Condition) -> Outcome:
        with one_thread():
            return self._outcome(condition)

    def _outcome(self, condition: Condition) -> Outcome:
        field, value = condition.field, condition.value
        recordings = simulated_recordings(
            plan_of(field, self.plan), self.seed, lambda scene: stressed(scene, field, value)
        )
        unscored, judged = dict[str, float](), dict[tuple[str, Truth], Judgement]()
        for name, (detector, debounce) in self.subjects.items():
            found = [probabilities(detector, recording) for recording in recordings]
            unscored[name] = _share([np.isnan(each)[WARM_UP:] for each in found])
            for truth in TRUTHS:
                judged[name, truth] = Judgement.of(recordings, found, debounce, truth)
        return Outcome(_share([_degraded(recording)[WARM_UP:] for recording in recordings]), unscored, judged)


def _distinct(condition: Condition) -> Condition:
    """The same recordings under the name that they are simulated by: nominal is nominal in any field."""
    grid = GRIDS[condition.field]
    if condition.value != grid.values[0] or condition.field == "slip_speed":
        return condition
    first = next(iter(GRIDS))
    return Condition(first, GRIDS[first].values[0])


def _tuned(detector: Detector, recordings: Sequence[LabelledRecording]) -> Debounce:
    slips = [Slips.labelled(recording) for recording in recordings]
    return tuned([probabilities(detector, recording) for recording in recordings], slips)


def _degraded(recording: LabelledRecording) -> Flags:
    assert recording.degraded is not None, "simulated recordings know it"
    return recording.degraded


def _share(flags: Sequence[Flags]) -> float:
    return percent(sum(int(each.sum()) for each in flags), sum(map(len, flags)))

"""`slipflow evaluate --stress`: every detector along every stress field of the simulation.

All conditions are simulated with the same seed, so that recordings differ only by the stress. Detectors are
compared with the label by arm speed, and with the true sliding of the contact: a stress of the motion stream
changes the label alone.
"""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import polars as pl

from connectors.sim.paper_plan import PaperPlan as Plan
from flows.learn.evaluation.evaluation_study import Evaluation, Progress, judge_all, method_results
from flows.learn.evaluation.folds import Fold
from flows.learn.evaluation.methods import Method, baselines, ready, trained_methods
from flows.learn.evaluation.stress_fields import FIELDS, plan_of, stressed
from flows.learn.labelled_recordings import simulated_recordings
from flows.report.results import joined
from flows.run.executor import map_tasks, one_thread

NOMINAL: Final = "nominal"  # condition
PLAN: Final = Plan(repeats=1, rotations=1)  # 16 recordings, 5 minutes
TRAINING: Final = Plan(repeats=3, rotations=1)  # 40 recordings, 14 minutes
SEED: Final = 4000
_FITTING: Final = 1000  # added to the seed for the recordings that baselines are fitted to
_TUNING: Final = 2000  # added to the seed for the recordings that the debounce is tuned on


def stress(
    models: Sequence[Path] = (),
    *,
    names: Collection[str] = (),
    seed: int = SEED,
    plan: Plan = PLAN,
    training: Plan = TRAINING,
    executor: Executor | None = None,
    progress: Progress = lambda _done, _all: None,
    log: Callable[[str], object] = lambda _: None,
) -> Evaluation:
    """Judge methods under every stress; the conditions of the results are those of `condition_name`.

    Args:
        models: Files of weights to judge as well.
        names: Only these methods, and those of `models`; empty: all.
        seed: Seed of the recordings.
        plan: Recordings of each condition.
        training: Plan of the nominal recordings, of other seeds, for fitting the baselines and tuning the
            debounce of methods without a card.
        executor: Executor of `workers`; None: this process.
        progress: Called with the number of conditions done, and of all.
        log: Receives progress messages.

    Raises:
        InputError: if a method or model does not exist.
        SlipflowError: if a worker died.
    """
    candidates = [*ready(trained_methods(models, names)), *baselines(names)]
    log("simulating the recordings to fit to")
    train, validation = (simulated_recordings(training, seed + more) for more in (_FITTING, _TUNING))
    tasks = [(each, Fold("", train, validation, ())) for each in candidates]
    fitted = judge_all("", tasks, (), executor=executor, log=log)
    conditions = {condition_name(field, value): (field, value) for field, value in every_condition()}
    work = partial(_results, list(fitted.methods.values()), plan, seed)
    results = joined(map_tasks(work, list(conditions.items()), executor, progress=progress))
    return replace(fitted, subject=f"simulated with seed {seed}", results=results)


def every_condition() -> list[tuple[str, float]]:
    """Return each value of each field."""
    return [(field, value) for field, values in FIELDS.items() for value in values.values]


def condition_name(field: str, value: float) -> str:
    """Return the name of a condition.

    The nominal value of every field gives the same recordings, except for slip speed, whose plan differs.

    >>> condition_name("noise", 14), condition_name("noise", 0.6), condition_name("slip_speed", 1)
    ('noise 14', 'nominal', 'slip_speed 1')
    """
    nominal = value == FIELDS[field].nominal and field != "slip_speed"
    return NOMINAL if nominal else f"{field} {value:g}"


@one_thread()
def _results(
    methods: Sequence[Method], plan: Plan, seed: int, condition: tuple[str, tuple[str, float]]
) -> pl.DataFrame:
    name, (field, value) = condition
    recordings = simulated_recordings(plan_of(field, plan), seed, lambda scene: stressed(scene, field, value))
    return joined(each for method in methods for each in method_results(method, recordings, condition=name))

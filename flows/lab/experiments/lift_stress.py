"""The lift under stress: friction, mass, delay, rate, a dead cell and the gripper, changed one at a time."""

from dataclasses import replace
from typing import Any, Final

from flows.lab.experiments.gripper_model import PATHS
from flows.lab.experiments.lift_trial import lift
from flows.lab.experiments.study import Method, Progress, Trials, ignore_progress, run_study
from flows.lab.experiments.study_report import condition_table
from flows.lab.experiments.trial import Conditions
from flows.report.report_page import Report, Section

NAME: Final = "lift-stress"
NOMINAL: Final = "nominal"
FRICTIONS: Final = (0.5, 0.75, 1.25, 1.5)  # factors
DELAYS: Final = (25, 50, 100, 150, 200)  # ms, added
RATES: Final = (50.0, 200.0)  # Hz; the detectors were trained at 100 Hz
DEAD: Final = 1  # the middle cell of the lower row
GOOD: Final = 90.0  # %, mean success


def stress(
    method: Method,
    conditions: Conditions,
    trials: Trials,
    command: str,
    *,
    jobs: int | None = None,
    progress: Progress = ignore_progress,
) -> Report:
    """Run the lift under each condition, which changes one setting in `conditions`; report the success.

    Raises:
        InputError: if there is no such detector.
        ParameterError: on less than one job.
        SlipflowError: if a process ended early.
    """
    tried = stress_conditions(conditions)
    results = run_study(lift, [method], tried, trials, jobs=jobs, progress=progress)
    good = sum(found.mean(method) >= GOOD for found in results.values())
    finding = f"{method} holds {GOOD:.0f} % or more under {good} of {len(results)} conditions, in {trials}"
    text = (
        "Success, %, by object; lost: fell out of the gripper, %; false: slips registered before anything "
        "slid, per trial. Slide and force are medians; force is relative to the least that holds, in trials "
        "that hold."
    )
    facts: dict[str, Any] = {
        "experiment": "lift",
        "trials": trials.count,
        "seed": trials.seed,
        "method": str(method),
        "mean_success": results[NOMINAL].mean(method),
    }
    return Report(
        f"The lift under stress: {method}",
        f"{trials}, the same under each condition, which differs from nominal in one setting.",
        [Section(NAME, finding, text, [condition_table(results, method)])],
        command,
        facts,
    )


def stress_conditions(nominal: Conditions) -> dict[str, Conditions]:
    """Return the conditions by name; each differs from nominal in one setting."""
    gripper = nominal.gripper

    def changed(**values: Any) -> Conditions:  # noqa: ANN401 - fields of several types
        return replace(nominal, gripper=replace(gripper, **values))

    return {
        NOMINAL: nominal,
        **{f"friction x{factor:g}": replace(nominal, friction=factor) for factor in FRICTIONS},
        "mass x2": replace(nominal, mass=2.0),
        f"cell {DEAD} dead": replace(nominal, dead_cells=(DEAD,)),
        "over MQTT": changed(path=PATHS["mqtt"]),
        **{f"delay +{delay} ms": changed(delay=gripper.delay + delay / 1000) for delay in DELAYS},
        **{f"{rate:g} Hz": replace(nominal, rate=rate) for rate in RATES},
        "gripper that locks": changed(locks=True),
        "gripper twice as fast": changed(rate=2 * gripper.rate),
    }

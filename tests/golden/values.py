"""Numbers that studies give on tiny simulated data; `python -m tests.golden.values` prints them as JSON.

The functions below adapt the results of a study to plain numbers. A number may only change together with the
method that it measures, and then in a commit of its own.
"""

import json
import sys
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias
from unittest.mock import patch

from connectors.sim.paper_plan import PaperPlan
from flows.lab.experiments.lift_trial import LiftOutcome
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.study import Trials, run_study
from flows.lab.experiments.tap_trial import TapOutcome
from flows.lab.simulation import simulate
from flows.learn.benchmark import folds
from flows.learn.benchmark.benchmark_study import benchmark
from flows.learn.benchmark.entrants import Course
from flows.learn.chart.chart_study import chart
from flows.learn.evaluation.evaluation_study import MethodResult, evaluate
from flows.learn.evaluation.event_metrics import EventMetrics, Performance
from flows.learn.evaluation.intervals import Figures
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.stress import stress_study
from flows.learn.stress.stress_fields import FIELDS
from flows.learn.training.recipe import Recipe

Numbers: TypeAlias = dict[str, Any]  # nested; leaves are numbers, strings and null
FIELDS_OF = {
    name: ["success", *(each.name for each in fields(kind))]
    for name, kind in (("tap", TapOutcome), ("lift", LiftOutcome))
}
METHODS = ("tcn", "psd", "logistic")


def every_value(folder: Path) -> Numbers:
    """Run all studies; datasets are written to a folder."""
    dataset = simulate(folder / "tiny", "tiny", seed=0).out
    return {
        "evaluate": evaluated(dataset),
        "chart": charted(dataset),
        "hold_out": held_out(dataset, folder),
        "stress": stressed(),
        "tap": tried("tap"),
        "lift": tried("lift"),
    }


def evaluated(dataset: Path) -> Numbers:
    found = evaluate(dataset, names=METHODS)
    return {
        "recordings": found.recordings,
        "samples": found.samples,
        "static": found.static,
        "minutes": found.minutes,
        "label": {target: _performance(each) for target, each in found.label.items()},
        "methods": {each.method.name: _evaluated_method(each) for each in found.results},
    }


def _evaluated_method(result: MethodResult) -> Numbers:
    confusion = result.confusion
    return {
        "confusion": confusion.counts.tolist(),
        "accuracy": confusion.accuracy,
        "balanced": confusion.balanced,
        "precision": confusion.precision,
        "f1": confusion.f1,
        "auc": 100 * result.roc.area,
        "ece": result.reliability.error,
        "table_3": {
            f"{kind.surface} {kind.kind} {kind.speed}": result.motions.at(kind).f1
            for kind in dict.fromkeys(result.motions.kinds)
        },
        "debounce": [result.debounce.threshold, result.debounce.consecutive, result.debounce.release],
        "errors within 100 ms": result.changes.near(100),
        "accuracy beyond 100 ms": result.changes.far(100),
        "events": _events(result.events),
        "paper_rule": _events(result.paper_rule),
        "targets": {target: _performance(each) for target, each in result.performance.items()},
        "figures": _figures(result.figures),
    }


def _events(events: EventMetrics) -> Numbers:
    return {
        "false_alarms": events.false_alarms,
        "false_alarms_per_min": events.false_alarms_per_min,
        "missed_slips": events.missed_slips,
        "slips": events.slips,
        "missed": events.missed,
        "delay": events.onset_ms,
        "late": events.late_ms,
    }


def _performance(found: Performance) -> Numbers:
    return {
        "accuracy": found.accuracy,
        "balanced": found.balanced,
        "false_alarms_per_min": found.false_alarms_per_min,
        "missed": found.missed,
        "delay": found.onset_ms,
        "lead": found.lead_ms,
    }


def _figures(found: Figures) -> Numbers:
    named = {
        "balanced": found.balanced,
        "far": found.far,
        "auc": found.area,
        "ece": found.calibration,
        "events_per_min": found.events_per_min,
        "false_alarms_per_min": found.false_alarms_per_min,
        "missed": found.missed,
        "delay": found.delay,
    }
    return {name: [each.value, each.low, each.high] for name, each in named.items()}


def charted(dataset: Path) -> Numbers:
    """Return the accuracy and events of each point of the chart, without its speed."""
    found = chart(dataset, names=["tcn", "psd"], span=1e-4)
    return {
        point.name: {target: _performance(each) for target, each in point.performances.items()}
        for point in found.points
    }


def held_out(dataset: Path, folder: Path) -> Numbers:
    """Return the results on each surface held out: of detectors as they are, and of a fitted baseline."""
    recordings = [replace(each, group=each.surface) for each in load(dataset)]

    def loaded(_dataset: Path, _rate: float | None = None) -> list[LabelledRecording]:
        return recordings

    with patch.object(folds, "load", loaded):
        found = benchmark(
            {"tiny": dataset},
            Course(Recipe(), folder / "models"),
            regimes=["zero-shot", "in-domain"],
            names=METHODS[1:],
            jobs=1,
        )
    return {
        each.entrant.title: {"figures": _figures(each.figures), "by_fold": dict(each.by_fold)}
        for each in found.datasets[0].results
    }


def stressed() -> Numbers:
    """Return the performance along one stress field."""
    plan = PaperPlan(surfaces=("plane",), speeds=(0.05,), repeats=1, rotations=0, rounds=1)
    with patch.object(stress_study, "FIELDS", {"noise": FIELDS["noise"]}):
        found = stress_study.stress(names=["tcn", "psd"], seed=7, plan=plan, training=plan, jobs=1)
    return {
        f"noise {value:g} {name} {target}": _performance(each)
        for (_, value), outcome in found.outcomes.items()
        for (name, target), each in outcome.performance.items()
    }


def tried(experiment: str) -> Numbers:
    """Return the outcome of each trial of an experiment."""
    methods = [Method("tcn_grasp"), Method("psd", "steps")]
    results = run_study(experiment, methods, Trials(2, objects=("box",)))
    outcomes: Numbers = {}
    for row in results.iter_rows(named=True):
        trial = f"{row['condition']} {row['method']} {row['recording'].replace('-', ' ')}"
        outcome = outcomes.setdefault(trial, dict.fromkeys(FIELDS_OF[experiment]))
        if row["metric"].startswith("ending "):
            outcome["ending"] = row["metric"].removeprefix("ending ")
        elif row["metric"] != "trials":
            outcome[row["metric"]] = row["value"]
    return outcomes


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        sys.stdout.write(json.dumps(every_value(Path(temporary)), indent=1).replace("NaN", "null"))
    sys.stdout.write("\n")

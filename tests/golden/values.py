"""Numbers that studies give on tiny simulated data; `python -m tests.golden.values` prints them as JSON.

The functions below adapt the results of a study to plain numbers. A number may only change together with the
method that it measures, and then in a commit of its own.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias
from unittest.mock import patch

import polars as pl

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import PaperStrokes
from flows.lab.experiments.study import Method, Trials, run_study
from flows.lab.simulation import simulate
from flows.learn.evaluation import evaluation_study, stress_study
from flows.learn.evaluation.evaluation_study import Evaluation, evaluate
from flows.learn.evaluation.stress_study import FIELDS
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.measures import AGAINST_SLIDING, BALANCED, EVENTS, SAMPLES, SHARES, SLIDING
from flows.report.results import Statistic, estimates

Numbers: TypeAlias = dict[str, Any]  # nested; leaves are numbers, strings and null
FIELDS_OF = {
    "tap": ("success", "ending", "false_firm", "slide", "lead", "moved", "soft", "false_soft"),
    "lift": ("success", "ending", "false_firm", "slide", "lead", "force", "peak"),
}
METHODS = ("tcn", "psd", "logistic")


def every_value(folder: Path) -> Numbers:
    """Run all studies; datasets are written to a folder."""
    dataset = simulate(folder / "tiny", "tiny", seed=0)
    found = evaluate(dataset, names=METHODS, speed=1e-4)
    return {
        "evaluate": evaluated(found, dataset),
        "hold_out": held_out(dataset),
        "stress": stressed(),
        "tap": tried("tap"),
        "lift": tried("lift"),
    }


def evaluated(found: Evaluation, dataset: Path) -> Numbers:
    counts, judged = sums(found.results.filter(method="tcn")), [r for r in load(dataset) if r.split == "test"]
    static = counts["static as static"] + counts["static as slip"]
    samples = static + counts["slip as slip"] + counts["slip as static"]
    return {
        "recordings": found.results["recording"].n_unique(),
        "samples": samples,
        "static": 100 * static / samples,
        "minutes": judged[0].sampling.minutes(sum(map(len, judged))),
        "label": against_targets(found.label),
        "methods": {
            name: {
                **evaluated_method(found.results.filter(method=name)),
                "debounce": [
                    getattr(method.debounce, each) for each in ("threshold", "consecutive", "release")
                ],
            }
            for name, method in found.methods.items()
        },
    }


def evaluated_method(results: pl.DataFrame) -> Numbers:
    counts, one = sums(results), values(results, SHARES)
    motions = {kind: results.filter(condition=kind) for kind in results["condition"].unique() if kind}
    return {
        "confusion": [[counts[f"{a} as {b}"] for b in ("static", "slip")] for a in ("static", "slip")],
        "precision": one["precision %"],
        "f1": one["F1 %"],
        "table_3": {kind: values(part, SHARES)["F1 %"] for kind, part in motions.items()},
        "targets": against_targets(results),
        "figures": figures(results),
    }


def against_targets(results: pl.DataFrame) -> Numbers:
    one = values(results, {**SHARES, **BALANCED, **EVENTS, **AGAINST_SLIDING})
    names = "balanced %", "false/min", "missed %", "delay ms"
    found = {
        target: {**{name: one[prefix + name] for name in names}, "lead ms": one["lead ms"]}
        for target, prefix in (("arm-speed", ""), ("sliding", SLIDING))
    }
    found["arm-speed"]["accuracy"] = one["accuracy %"]
    return found


def figures(results: pl.DataFrame) -> Numbers:
    found = estimates(results, {**SAMPLES, **EVENTS}).select("value", "low", "high").rows()
    names = ("balanced", "far", "auc", "ece", "events_per_min", "false_alarms_per_min", "missed", "delay")
    return {name: list(each) for name, each in zip(names, found, strict=True)}


def sums(results: pl.DataFrame) -> dict[str, float]:
    return dict(results.group_by("metric").agg(pl.col("value").sum()).rows())


def values(results: pl.DataFrame, statistics: Mapping[str, Statistic]) -> dict[str, float]:
    return dict(estimates(results, statistics, draws=0).select("statistic", "value").rows())


def held_out(dataset: Path) -> Numbers:
    """Return the result of each surface held out: detectors as they are, and a fitted baseline."""
    recordings = [replace(each, group=each.strokes.surface) for each in load(dataset) if each.strokes]

    def loaded(*_args: object, **_named: object) -> list[LabelledRecording]:
        return recordings

    with patch.object(evaluation_study, "load", loaded):
        found = evaluate(dataset, hold_out=["all"], train=True, names=["psd", "logistic"])
    return {
        {"psd": "zero-shot psd", "logistic": "in-domain logistic"}[name]: {
            "figures": figures(part),
            "by_fold": dict(estimates(part, BALANCED, ("fold",)).select("fold", "value").rows()),
        }
        for (name,), part in found.results.group_by("method")
    }


def stressed() -> Numbers:
    """Return the performance along one stress field."""
    plan = PaperPlan(
        surfaces=("plane",), speeds=(0.05,), repeats=1, rotations=0, strokes=PaperStrokes(rounds=1)
    )
    with patch.object(stress_study, "FIELDS", {"noise": FIELDS["noise"]}):
        found = stress_study.stress(names=["tcn", "psd"], seed=7, plan=plan, training=plan)
    return {
        f"{condition.replace('nominal', 'noise 0.6')} {name} {target}": each
        for (condition, name), part in found.results.group_by("condition", "method")
        for target, each in against_targets(part).items()
    }


def tried(experiment: str) -> Numbers:
    """Return the outcome of each trial of an experiment."""
    methods = [Method("tcn"), Method("psd", "steps")]
    results = run_study(experiment, methods, Trials(2, objects=("box",)))
    outcomes: Numbers = {}
    for row in results.iter_rows(named=True):
        trial = f"{row['condition']} {row['method']} {row['recording'].replace('-', ' ')}"
        outcome = outcomes.setdefault(trial, dict.fromkeys(FIELDS_OF[experiment]))
        if row["metric"].startswith("ending "):
            outcome["ending"] = row["metric"].removeprefix("ending ")
        elif row["metric"] in outcome:
            outcome[row["metric"]] = row["value"]
    return outcomes


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        found = every_value(Path(temporary))
    sys.stdout.write(json.dumps(found, indent=1).replace("NaN", "null") + "\n")

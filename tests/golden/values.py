"""Numbers that studies give on tiny simulated data; `python -m tests.golden.values` prints them as JSON.

A number may only change together with the method that it measures, and then in a commit of its own.
"""

import json
import sys
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
from flows.learn.evaluation.evaluation_study import evaluate
from flows.learn.evaluation.stress_study import FIELDS
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.measures import AGAINST_SLIDING, EVENTS, SAMPLES, SHARES
from flows.report.results import estimates

Numbers: TypeAlias = dict[str, Any]  # nested; leaves are numbers, strings and null


def every_value(folder: Path) -> Numbers:
    """Run all studies; datasets are written to a folder."""
    dataset = simulate(folder / "tiny", "tiny", seed=0)
    return {
        "evaluate": evaluated(dataset),
        "hold_out": held_out(dataset),
        "stress": stressed(),
        "tap": tried("tap"),
        "lift": tried("lift"),
    }


def statistics(results: pl.DataFrame, *by: str) -> Numbers:
    """Return the statistics of groups of results, each with the ends of its interval if it has one."""
    found = estimates(results, {**SHARES, **SAMPLES, **EVENTS, **AGAINST_SLIDING}, by).rows()
    return {
        " | ".join(row[:-3]): [each for each in row[-3:] if each is not None]
        for row in found
        if row[-3] is not None
    }


def sums(results: pl.DataFrame, *by: str) -> Numbers:
    """Return the sums of all metrics of groups of results."""
    found = results.group_by(*by, "metric", maintain_order=True).agg(pl.col("value").sum()).rows()
    return {" | ".join(row[:-1]): row[-1] for row in found}


def evaluated(dataset: Path) -> Numbers:
    found = evaluate(dataset, names=("tcn", "psd", "logistic"), speed=1e-4)
    return {
        "recordings": found.results["recording"].n_unique(),
        "sums": sums(found.results, "method"),
        "methods": statistics(found.results, "method"),
        "motions": statistics(found.results, "method", "condition"),
        "label": statistics(found.label, "method"),
        "debounce": {name: repr(method.debounce) for name, method in found.methods.items()},
    }


def held_out(dataset: Path) -> Numbers:
    """Return the result of each surface held out: detectors as they are, and a fitted baseline."""
    recordings = [replace(each, group=each.strokes.surface) for each in load(dataset) if each.strokes]

    def loaded(*_args: object, **_named: object) -> list[LabelledRecording]:
        return recordings

    with patch.object(evaluation_study, "load", loaded):
        found = evaluate(dataset, hold_out=["all"], train=True, names=["psd", "logistic"])
    return statistics(found.results, "method") | statistics(found.results, "method", "fold")


def stressed() -> Numbers:
    """Return the performance along one stress field."""
    plan = PaperPlan(
        surfaces=("plane",), speeds=(0.05,), repeats=1, rotations=0, strokes=PaperStrokes(rounds=1)
    )
    with patch.object(stress_study, "FIELDS", {"noise": FIELDS["noise"]}):
        found = stress_study.stress(names=["tcn", "psd"], seed=7, plan=plan, training=plan)
    return statistics(found.results, "condition", "method")


def tried(experiment: str) -> Numbers:
    """Return the outcome of each trial of an experiment."""
    methods = [Method("tcn"), Method("psd", "steps")]
    return sums(run_study(experiment, methods, Trials(2, objects=("box",))), "recording", "method")


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        found = every_value(Path(temporary))
    sys.stdout.write(json.dumps(found, indent=1).replace("NaN", "null") + "\n")

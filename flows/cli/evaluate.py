"""The command `slipflow evaluate`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import AsJson, Labels, Methods, Models
from flows.cli.report_output import (
    Budget,
    Dataset,
    ReportFolder,
    method_options,
    prepare_report,
    write_report,
)
from flows.cli.terminal import note


def evaluate(
    dataset: Dataset,
    *,
    split: Annotated[
        str, typer.Option(help="Split to evaluate on: train, validation, test or all.")
    ] = "test",
    model: Models = None,
    method: Methods = None,
    budget: Budget = 2.0,
    labels: Labels = "hand",
    out: ReportFolder = Path("evaluation"),
    as_json: AsJson = False,
) -> None:
    """Compare detectors on a dataset.

    Prints Tables I and III next to the paper's results, false alarms, missed slips and onset delay. Writes
    evaluation.html, .md, .json and figures. Needs the train extra.

    Examples:
      slipflow evaluate recordings --model mine.safetensors --method psd --out evaluation
    """
    from flows.learn.evaluation.evaluation_report import evaluation_report
    from flows.learn.evaluation.evaluation_study import evaluate as run_evaluation

    prepare_report(out)
    models, names = model or [], method or []
    found = run_evaluation(
        dataset, split=split, models=models, names=names, budget=budget, labels=labels, log=note
    )
    only_arm = " --labels arm" if labels == "arm" else ""
    options = f"--split {split}{method_options(models, names)} --budget {budget:g}{only_arm}"
    report = evaluation_report(found, f"slipflow evaluate {found.dataset} {options}")
    write_report(report, out, "evaluation", as_json=as_json)

"""The command `slipflow evaluate`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import Cluster, Jobs, ReportFolder
from flows.cli.terminal import command_line, note, progress_bar, write_report

_TURN = 0.02  # s, CPU time of each turn of timing


def evaluate(
    dataset: Annotated[
        Path | None, typer.Argument(metavar="DATASET", help="Labelled dataset, with splits or groups.")
    ] = None,
    *,
    split: Annotated[
        str, typer.Option(help="Split to judge detectors on: train, validation, test or all.")
    ] = "test",
    hold_out: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GROUP",
            help="Judge detectors on this surface or object (`group` of the sessions); repeatable; all: each"
            " in turn.",
        ),
    ] = None,
    train: Annotated[
        bool, typer.Option("--train", help="With --hold-out: also train detectors on the other groups.")
    ] = False,
    stress: Annotated[
        bool, typer.Option("--stress", help="Judge detectors along simulated stresses, without a dataset.")
    ] = False,
    chart: Annotated[
        bool, typer.Option("--chart", help="Also measure the CPU time of each detector.")
    ] = False,
    method: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE",
            help="NAME: judge only this detector. FILE: judge this model, too. Repeatable (default: all).",
        ),
    ] = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    out: ReportFolder = Path("evaluation"),
) -> None:
    """Compare detectors on a dataset.

    Prints accuracy (Tables I and III of the paper, with its results), false alarms, missed slips and delay,
    with intervals over recordings. Baselines are fitted to the train split, without recordings that are
    judged. Writes evaluation.html, .md, .json and figures (with --stress, stress.html and so on). Baselines
    need the extra `baselines`, --train the extra `train`, figures `report`.

    With --hold-out, detectors are judged on surfaces or objects. With --stress, the scene is simulated from
    nominal to extreme conditions.

    Examples:
      slipflow evaluate recordings --method mine.safetensors --method psd
      slipflow evaluate recordings --hold-out all --train
      slipflow evaluate recordings --chart
      slipflow evaluate --stress --method tcn --method psd --jobs 2
    """
    from flows.learn.evaluation.evaluation_report import evaluation_report, size_text, stress_report
    from flows.learn.evaluation.evaluation_study import evaluate as run_evaluation
    from flows.learn.evaluation.stress_study import stress as run_stress
    from flows.report.figures import missing_matplotlib
    from flows.report.report_page import check_output_folder
    from flows.run.executor import workers
    from operators.errors import InputError

    if (dataset is None) != stress:
        raise InputError("evaluate", "needs a dataset, or --stress without one")
    if train and not hold_out:
        raise InputError("--train", "needs --hold-out: a detector is judged on groups that it did not see")
    if hold_out and split != "test":
        raise InputError("--hold-out", "judges groups of all splits: omit --split")
    if stress and (hold_out or chart or split != "test"):
        raise InputError("--stress", "judges simulated recordings: omit --split, --hold-out and --chart")
    check_output_folder(out)
    if reason := missing_matplotlib():
        note(f"the report will have no figures, which {reason}")
    with workers(jobs, cluster) as executor, progress_bar("evaluating") as update:
        if dataset is None:
            found = run_stress(names=method or [], executor=executor, progress=update)
        else:
            found = run_evaluation(
                dataset,
                split=split,
                hold_out=hold_out or [],
                train=train,
                names=method or [],
                speed=_TURN if chart else 0,
                executor=executor,
                progress=update,
            )
    if not stress:
        note(f"judged on {found.subject}: {size_text(found)}")
    for line in (*(f"not evaluated: {name}: {why}" for name, why in found.missing.items()), *found.notes):
        note(line)
    report = (stress_report if stress else evaluation_report)(found, command_line())
    write_report(report, out, "stress" if stress else "evaluation")

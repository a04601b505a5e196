"""The command `slipflow experiment`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import Cluster, Jobs, ReportFolder
from flows.cli.terminal import command_line, progress_bar, write_report


def experiment(
    name: Annotated[
        str,
        typer.Argument(
            metavar="tap|lift", help="tap: a mallet hits held objects. lift: lift weakly gripped objects."
        ),
    ],
    *,
    trials: Annotated[int, typer.Option(min=1, help="Number of trials of each object.")] = 20,
    method: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DETECTOR[:RULE]",
            help="Detector (tcn, threshold, psd, paper_tcn, another name or a model file) and grip force"
            " rule (ours, steps or none); repeatable (default: these four, tcn with our rule, the others"
            " with the paper's, steps).",
        ),
    ] = None,
    objects: Annotated[
        list[str] | None,
        typer.Option(
            "--object",
            metavar="NAME",
            help="Object: box, ball, cardboard_can, football_sleeve, foam_sleeve, metal_can, or random (six"
            " times as many trials); repeatable (default: all).",
        ),
    ] = None,
    stress: Annotated[
        bool, typer.Option("--stress", help="Also vary friction, mass, delay, sample rate and stiffness.")
    ] = False,
    jobs: Jobs = None,
    cluster: Cluster = None,
    out: ReportFolder = Path("experiment"),
) -> None:
    """Run a robot experiment of the paper in simulation.

    Detected slips change the grip force. Prints success next to that of the paper, false slips, causes of
    failed trials, slides and holding forces. Writes tap.html or lift.html, .md and .json.

    Examples:
      slipflow experiment tap
      slipflow experiment lift --object ball --trials 5 --method psd:none
      slipflow experiment lift --stress --trials 5
    """
    from flows.lab.experiments.experiment_report import experiment_report
    from flows.lab.experiments.study import METHODS, Trials, parse_method, run_study
    from flows.report.report_page import check_output_folder
    from flows.run.executor import workers

    # a repeated method or object counts once, else its trials would count twice
    methods = list(dict.fromkeys(map(parse_method, method or ()))) or list(METHODS)
    chosen = Trials(trials, tuple(dict.fromkeys(objects or Trials.objects)))
    check_output_folder(out)
    with workers(jobs, cluster) as executor, progress_bar(name) as update:
        results = run_study(name, methods, chosen, stress=stress, executor=executor, progress=update)
    report = experiment_report(name, results, chosen, command_line())
    write_report(report, out, name)

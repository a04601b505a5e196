"""The commands `slipflow experiment tap`, `lift` and `learn`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.commands import command_group, register
from flows.cli.experiment_options import (
    Count,
    Delay,
    Detectors,
    Jobs,
    Locks,
    Objects,
    Out,
    Rate,
    Route,
    Rules,
    Seed,
    command_line,
    conditions_of,
    methods_of,
    trials_of,
)
from flows.cli.options import AsJson
from flows.cli.report_output import prepare_report, write_report
from flows.cli.terminal import check_output_file, note, progress_bar

app = command_group("Run the paper's robot experiments in simulation, closed loop.")


def tap(
    context: typer.Context,
    *,
    count: Count = 20,
    method: Detectors = None,
    objects: Objects = None,
    seed: Seed = 900_000,
    rate: Rate = 100.0,
    jobs: Jobs = None,
    out: Out = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Hit held objects with a mallet and count the registered slips.

    Prints success next to the paper's, failed trials by ending, and false slips. Writes tap.html, .md, .json
    and .svg.

    Examples:
      slipflow experiment tap --method tcn --object ball --trials 5
    """
    from flows.lab.experiments.study import DEFAULT, Method, run_study
    from flows.lab.experiments.study_report import tap_report
    from flows.lab.experiments.tap_trial import tap as run_tap

    usual = [Method(name) for name in (DEFAULT, "tcn", "paper_tcn", "frequency_cnn", "psd")]
    methods, trials = methods_of(usual, method, None), trials_of(count, seed, objects)
    conditions = {"": conditions_of("direct", "0s", rate)}
    prepare_report(out)
    with progress_bar("tap") as update:
        found = run_study(run_tap, methods, conditions, trials, jobs=jobs, progress=update)
    write_report(tap_report(found[""], command_line(context)), out, "tap", as_json=as_json)


def lift(
    context: typer.Context,
    *,
    count: Count = 20,
    method: Detectors = None,
    rule: Rules = None,
    objects: Objects = None,
    seed: Seed = 900_000,
    path: Route = "direct",
    delay: Delay = "0s",
    rate: Rate = 100.0,
    locks: Locks = False,
    stress: Annotated[
        bool,
        typer.Option(
            "--stress", help="Vary friction, mass, delay, rate, dead cells and gripper, one at a time."
        ),
    ] = False,
    ablation: Annotated[
        bool, typer.Option("--ablation", help="Find the delay and rate at which the lift fails.")
    ] = False,
    jobs: Jobs = None,
    out: Out = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Lift weakly gripped objects and count those that are held.

    Prints success next to the paper's, failed trials by ending, slides and holding forces.
    Writes lift.html, .md, .json and .svg; with --stress lift-stress.html, .md and .json; with --ablation
    lift-ablation.html, .md, .json and .svg. --ablation
    sets path, delay, rate and gripper.

    Examples:
      slipflow experiment lift --object ball --trials 5
      slipflow experiment lift --method tcn --rule steps --delay 50ms
      slipflow experiment lift --ablation --method psd --trials 10
    """
    if stress and ablation:
        raise typer.BadParameter("--stress and --ablation: give one of them")
    if stress and max(len(method or ()), len(rule or ())) > 1:
        raise typer.BadParameter("--stress takes one --method and one --rule")
    conditions = conditions_of(path, delay, rate, locks=locks)
    if ablation and conditions != conditions_of("direct", "0s", 100):
        raise typer.BadParameter("--ablation takes no --path, --delay, --rate or --locks: it sets these")
    from flows.lab.experiments.study import DEFAULT, NONE, OURS, STEPS, Method

    trials, again = trials_of(count, seed, objects), command_line(context)
    usual = [Method(DEFAULT, each) for each in (OURS, STEPS, NONE)]
    usual += [Method("tcn"), *(Method(name, STEPS) for name in ("tcn", "paper_tcn", "frequency_cnn", "psd"))]
    methods = methods_of(usual, method, rule)
    prepare_report(out)
    with progress_bar("lift") as update:
        if ablation:
            from flows.lab.experiments.ablation_report import ablation_report
            from flows.lab.experiments.lift_ablation import METHODS, ablate

            given = method or ([each.detector for each in METHODS] if rule else None)
            found = ablate(methods_of(METHODS, given, rule), trials, jobs=jobs, progress=update)
            report = ablation_report(found, again)
        elif stress:
            from flows.lab.experiments.lift_stress import stress as run_stress

            report = run_stress(methods[0], conditions, trials, again, jobs=jobs, progress=update)
        else:
            from flows.lab.experiments.lift_trial import lift as run_lift
            from flows.lab.experiments.study import run_study
            from flows.lab.experiments.study_report import lift_report

            results = run_study(run_lift, methods, {"": conditions}, trials, jobs=jobs, progress=update)
            report = lift_report(results[""], again)
    write_report(report, out, report.sections[0].name, as_json=as_json)


def learn(
    *,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Model file, .safetensors; its card has the same name with .json.",
        ),
    ] = Path("tcn_grasp.safetensors"),
    grasps: Annotated[int, typer.Option(min=20, help="Number of simulated grasps to train on.")] = 4000,
    steps: Annotated[int, typer.Option(min=1, help="Number of training steps.")] = 2600,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the recordings.")] = 7000,
    as_json: AsJson = False,
) -> None:
    """Train the grasp detector, tcn_grasp.

    Trains on simulated grasps and strokes, labelled by true sliding. The six objects of the experiments
    are not among them. Needs the train extra.

    Examples:
      slipflow experiment learn -o mine.safetensors
    """
    from dataclasses import replace

    from flows.lab.experiments.grasp_training import RECIPE
    from flows.lab.experiments.grasp_training import learn as train
    from flows.learn.training.learning_curve import Check

    check_output_file(out)
    with progress_bar("training tcn_grasp") as update:

        def progress(done: int, total: int, check: Check | None) -> None:
            update(done, total)
            if check:
                note(f"{check.done}: {check.accuracy:.2f} % on validation, {check.seconds:.0f} s")

        model = train(
            out, seed=seed, grasps=grasps, recipe=replace(RECIPE, steps=steps), log=note, progress=progress
        )
    scores = ", ".join(f"{each['balanced']:.2f} % on {kind}" for kind, each in model.card["scores"].items())
    summary = {"path": str(model.path), **model.card}
    typer.echo(json.dumps(summary) if as_json else f"{model.path}: balanced accuracy {scores}")


for each in (tap, lift, learn):
    register(app, each)

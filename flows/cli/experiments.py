"""The commands `slipflow experiment tap`, `lift` and `learn`."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli.commands import command_group, register
from flows.cli.options import AsJson, Jobs
from flows.cli.report_output import ReportFolder, prepare_report, write_report
from flows.cli.terminal import check_output_file, note, progress_bar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from flows.lab.experiments.study import Method, Trials

app = command_group("Run the paper's robot experiments in simulation, closed loop.")

Count = Annotated[int, typer.Option("--trials", min=1, help="Number of trials of each object.")]
Seed = Annotated[
    int, typer.Option(min=0, help="Random seed of the first trial; it increases by 1 per trial.")
]
Objects = Annotated[
    list[str] | None,
    typer.Option(
        "--object",
        metavar="NAME",
        help="Object: box, ball, cardboard_can, football_sleeve, foam_sleeve or metal_can; repeatable"
        " (default: all).",
    ),
]
Detectors = Annotated[
    list[str] | None,
    typer.Option(
        "--method", metavar="NAME", help="Detector, by name or model file; repeatable (default: several)."
    ),
]
Rules = Annotated[
    list[str] | None,
    typer.Option(
        "--rule",
        metavar="NAME",
        help="Grip force rule: ours, steps (the paper's) or none; repeatable (default: several).",
    ),
]
_OUTPUT = ("jobs", "out", "as_json")  # parameters that do not change the results


def tap(
    context: typer.Context,
    *,
    count: Count = 20,
    method: Detectors = None,
    objects: Objects = None,
    seed: Seed = 900_000,
    jobs: Jobs = None,
    out: ReportFolder = Path("experiment"),
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
    prepare_report(out)
    with progress_bar("tap") as update:
        study = run_study(run_tap, methods, trials, jobs=jobs, progress=update)
    write_report(tap_report(study, command_line(context)), out, "tap", as_json=as_json)


def lift(
    context: typer.Context,
    *,
    count: Count = 20,
    method: Detectors = None,
    rule: Rules = None,
    objects: Objects = None,
    seed: Seed = 900_000,
    stress: Annotated[
        bool,
        typer.Option("--stress", help="Vary delay, sample rate, friction, mass, grip, speed and gripper."),
    ] = False,
    jobs: Jobs = None,
    out: ReportFolder = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Lift weakly gripped objects and count those that are held.

    Prints success next to the paper's, failed trials by ending, slides and holding forces. Writes lift.html,
    .md, .json and .svg. --stress prints success under each condition, and the delay at which each object is
    no longer held. It writes lift-stress.html, .md, .json and .svg.

    Examples:
      slipflow experiment lift --object ball --trials 5
      slipflow experiment lift --method tcn --rule steps
      slipflow experiment lift --stress --method psd --trials 10
    """
    from flows.lab.experiments.lift_stress import CONDITIONS, METHODS, stress_report
    from flows.lab.experiments.lift_trial import lift as run_lift
    from flows.lab.experiments.study import DEFAULT, NONE, OURS, STEPS, Method, run_study
    from flows.lab.experiments.study_report import lift_report

    usual = [Method(DEFAULT, each) for each in (OURS, STEPS, NONE)]
    usual += [Method("tcn"), *(Method(name, STEPS) for name in ("tcn", "paper_tcn", "frequency_cnn", "psd"))]
    trials, tried, report = trials_of(count, seed, objects), None, lift_report
    if stress:
        tried, report, usual = CONDITIONS, stress_report, list(METHODS)
        method = method or ([each.detector for each in METHODS] if rule else None)
    methods = methods_of(usual, method, rule)
    prepare_report(out)
    with progress_bar("lift") as update:
        study = run_study(run_lift, methods, trials, tried, jobs=jobs, progress=update)
    found = report(study, command_line(context))
    write_report(found, out, found.sections[0].name, as_json=as_json)


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


def command_line(context: typer.Context) -> str:
    """Return the command that repeats this run: all options that change its results and are not defaults."""
    words = ["slipflow", "experiment", str(context.info_name)]
    for option in context.command.params:
        value: Any = context.params.get(str(option.name))
        if option.name in _OUTPUT or value in (option.default, None, []):
            continue
        for each in value if getattr(option, "multiple", False) else [value]:
            words.append(option.opts[0])
            words += [] if each is True else [f"{each:g}" if isinstance(each, float) else str(each)]
    return shlex.join(words)


def trials_of(count: int, seed: int, objects: list[str] | None) -> "Trials":
    """Return the trials of a study.

    Raises:
        ParameterError: on an unknown object.
    """
    from connectors.sim.objects import OBJECTS
    from flows.lab.experiments.study import Trials

    return Trials(count, seed, tuple(objects or OBJECTS))


def methods_of(
    usual: "Sequence[Method]", detectors: list[str] | None, rules: list[str] | None
) -> "list[Method]":
    """Return each named detector with each rule; without names, the usual methods that have these rules.

    Raises:
        ParameterError: on an unknown rule.
    """
    from flows.lab.experiments.study import OURS, Method

    if detectors:
        return [Method(detector, rule) for detector in detectors for rule in rules or [OURS]]
    for rule in rules or []:
        Method("", rule)
    return [method for method in usual if not rules or method.rule in rules]


for each in (tap, lift, learn):
    register(app, each)

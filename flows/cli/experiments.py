"""The commands `slipflow experiment tap`, `lift` and `learn`."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli.commands import register
from flows.cli.options import AsJson, Jobs
from flows.cli.report_output import ReportFolder, prepare_report, write_report
from flows.cli.terminal import note, progress_bar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from flows.lab.experiments.rivals import Method
    from flows.lab.experiments.study import Experiment, Trials

experiment = typer.Typer(
    help="Run the paper's robot experiments in closed loop, simulated.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

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
        "--method",
        metavar="NAME",
        help="Detector: threshold, psd or paper, which are tuned on grasps, another name or a model file;"
        " repeatable (default: tcn_grasp and these three). `slipflow models` says what each is meant for; tcn"
        " is for strokes and misses slips of held objects.",
    ),
]
Rules = Annotated[
    list[str] | None,
    typer.Option(
        "--rule",
        metavar="NAME",
        help="Grip force rule: ours, steps (the paper's) or none; repeatable"
        " (default: steps for threshold, psd and paper, otherwise ours).",
    ),
]
Stress = Annotated[
    bool,
    typer.Option("--stress", help="Vary friction, mass, latency, sample rate, stiffness and the pad."),
]
_OUTPUT = ("jobs", "out", "as_json")  # parameters that do not change the results


def tap(
    context: typer.Context,
    *,
    count: Count = 20,
    method: Detectors = None,
    objects: Objects = None,
    seed: Seed = 900_000,
    stress: Stress = False,
    jobs: Jobs = None,
    out: ReportFolder = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Hit held objects with a mallet and count registered slips.

    Prints success next to the paper's, false slips and failed trials by ending. Writes tap.html, .md, .json
    and .svg. --stress prints where each method breaks and writes tap-stress.html, .md, .json and .svg.

    Examples:
      slipflow experiment tap --object ball --trials 5
      slipflow experiment tap --stress --method psd --trials 5
    """
    from flows.lab.experiments.tap_trial import tap as run_tap

    _run(
        context,
        run_tap,
        methods_of(method, None),
        trials_of(count, seed, objects),
        stress,
        jobs,
        out,
        as_json,
    )


def lift(
    context: typer.Context,
    *,
    count: Count = 20,
    method: Detectors = None,
    rule: Rules = None,
    objects: Objects = None,
    seed: Seed = 900_000,
    stress: Stress = False,
    jobs: Jobs = None,
    out: ReportFolder = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Lift weakly gripped objects and count those that are held.

    Prints success next to the paper's, false slips, failed trials by ending, slides and holding forces.
    Writes lift.html, .md, .json and .svg. --stress prints where each method breaks and writes
    lift-stress.html, .md, .json and .svg.

    Examples:
      slipflow experiment lift --object ball --trials 5
      slipflow experiment lift --method tcn --rule steps
      slipflow experiment lift --stress --trials 5
    """
    from flows.lab.experiments.lift_trial import lift as run_lift

    _run(
        context,
        run_lift,
        methods_of(method, rule),
        trials_of(count, seed, objects),
        stress,
        jobs,
        out,
        as_json,
    )


def _run(  # noqa: PLR0917 - the options of both commands
    context: typer.Context,
    run: "Experiment",
    methods: "Sequence[Method]",
    trials: "Trials",
    stress: bool,  # noqa: FBT001
    jobs: int | None,
    out: Path,
    as_json: bool,  # noqa: FBT001
) -> None:
    """Run an experiment and write its report."""
    from flows.lab.experiments.break_report import break_report, conditions_of
    from flows.lab.experiments.study import run_study
    from flows.lab.experiments.study_report import experiment_report
    from storage.models import PURPOSES

    name = str(context.info_name)
    for detector in dict.fromkeys(method.detector for method in methods):
        if detector in PURPOSES and PURPOSES[detector].task == "strokes":
            note(f"{detector} is meant for strokes and misses slips of held objects; tcn_grasp is for grasps")
    prepare_report(out)
    conditions, report = (conditions_of(name), break_report) if stress else (None, experiment_report)
    with progress_bar(name) as update:
        study = run_study(run, methods, trials, conditions, jobs=jobs, progress=update)
    write_report(
        report(study, command_line(context)), out, f"{name}-stress" if stress else name, as_json=as_json
    )


def learn(
    *,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder of the models and their cards.")
    ] = Path("models"),
    grasps: Annotated[int, typer.Option(min=20, help="Number of simulated grasps to train on.")] = 4000,
    steps: Annotated[int, typer.Option(min=1, help="Number of training steps of our network.")] = 2600,
    epochs: Annotated[int, typer.Option(min=1, help="Number of epochs of the paper's network.")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the recordings.")] = 7000,
    jobs: Jobs = None,
    as_json: AsJson = False,
) -> None:
    """Train tcn_grasp and the paper's network; tune thresholds.

    Trains on simulated grasps and strokes, labelled by true sliding. Neither the six objects of the
    experiments nor their fingertip are among them, nor among the objects that tune the thresholds. Needs the
    train extra.

    Examples:
      slipflow experiment learn -o models
    """
    from dataclasses import replace

    from flows.lab.experiments.grasp_training import Course
    from flows.lab.experiments.grasp_training import learn as train
    from flows.learn.training.learning_curve import Check
    from flows.report.report_page import check_output_folder

    check_output_folder(out)
    usual = Course()
    course = replace(
        usual,
        seed=seed,
        grasps=grasps,
        recipe=replace(usual.recipe, steps=steps),
        paper=replace(usual.paper, epochs=epochs),
    )
    with progress_bar("training") as update:

        def progress(done: int, total: int, check: Check | None) -> None:
            update(done, total)
            if check:
                text = f"step {done} of {total}: accuracy {check.accuracy:.2f} % on validation"
                note(f"{text}, {check.seconds:.0f} s")

        models = train(out, course, jobs=jobs, log=note, progress=progress)
    if as_json:
        typer.echo(json.dumps({name: {"path": str(each.path), **each.card} for name, each in models.items()}))
        return
    for model in models.values():
        scores = ", ".join(
            f"{each['balanced']:.2f} % on {kind}" for kind, each in model.card["scores"].items()
        )
        typer.echo(f"{model.path}: balanced accuracy on the test split, against true sliding: {scores}")


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


def methods_of(detectors: list[str] | None, rules: list[str] | None) -> "list[Method]":
    """Return each detector with each rule; by default the usual detectors, each with its usual rule.

    Raises:
        ParameterError: on an unknown rule.
    """
    from flows.lab.experiments.rivals import METHODS, Method

    usual = {method.detector: method for method in METHODS}
    named = [usual.get(name, Method(name)) for name in detectors or usual]
    return [Method(method.detector, rule) for method in named for rule in rules or [method.rule]]


for each in (tap, lift, learn):
    register(experiment, each, each.__name__)

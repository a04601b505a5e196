"""The commands about the robot experiments."""

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, TypeVar

import typer

from flows.cli.examples import examples
from flows.cli.experiment_options import (
    Break,
    Delay,
    Detectors,
    Jobs,
    Locks,
    Out,
    Rate,
    Rules,
    Seed,
    Sweep,
    Things,
    Trials,
    Way,
    as_given,
    command,
    conditions_of,
    methods_of,
    objects_of,
    of,
    under,
)
from flows.cli.options import AsJson, check_output_file, progress_bar, told

if TYPE_CHECKING:
    from collections.abc import Callable

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Found = TypeVar("Found")
Of = TypeVar("Of", contravariant=True)

app = typer.Typer(
    help="The paper's robot experiments, simulated, closed loop.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command(epilog=examples("tap"))
def tap(
    *,
    trials: Trials = 20,
    method: Detectors = None,
    thing: Things = None,
    seed: Seed = 900_000,
    rate: Rate = 100.0,
    jobs: Jobs = None,
    out: Out = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Hit what is held with a mallet: is the slip registered?

    And the rest after it? Prints success beside the paper's, how trials failed, and what is registered where
    nothing slips. Writes tap.html, .md, .json and .svg.
    """
    from flows.lab.experiments import experiment_page as page
    from flows.lab.experiments.experiment import BESIDE, DEFAULT, Method, experiment

    methods, objects = methods_of([Method(DEFAULT), *BESIDE["tap"]], method, None), objects_of(thing)
    conditions = conditions_of("direct", "0s", rate)
    measure = partial(
        experiment,
        "tap",
        methods,
        trials=trials,
        seed=seed,
        objects=objects,
        conditions=conditions,
        jobs=jobs,
    )
    again = command("tap", *as_given(method, None, thing), *under(rate=rate), *of(trials, seed))
    _carry_out("tap", measure, page, again, out, as_json=as_json)


@app.command(epilog=examples("lift"))
def lift(
    *,
    trials: Trials = 20,
    method: Detectors = None,
    rule: Rules = None,
    thing: Things = None,
    seed: Seed = 900_000,
    path: Way = "direct",
    delay: Delay = "0s",
    rate: Rate = 100.0,
    locks: Locks = False,
    stress: Sweep = False,
    ablation: Break = False,
    jobs: Jobs = None,
    out: Out = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Lift what is gripped too weakly: is it caught by more force?

    Prints success beside the paper's, how trials failed, how far objects slid and the force it took. Writes
    lift.html, .md, .json and .svg; with --stress lift-stress.html, .md and .json; with --ablation
    lift-ablation.html, .md, .json and .svg, for which path, delay, rate and hand are the experiment's own.
    """
    if stress and ablation:
        raise typer.BadParameter("--stress and --ablation: give one of them")
    if stress and max(len(method or ()), len(rule or ())) > 1:
        raise typer.BadParameter("--stress takes one --method and one --rule")
    conditions = conditions_of(path, delay, rate, locks=locks)
    if ablation and conditions != conditions_of("direct", "0s", 100):
        raise typer.BadParameter("--ablation takes no --path, --delay, --rate or --locks: it tries its own")
    from flows.lab.experiments import ablation_page
    from flows.lab.experiments import experiment_page as page
    from flows.lab.experiments import lift_stress_page as stress_page
    from flows.lab.experiments.experiment import BESIDE, DEFAULT, Method, experiment
    from flows.lab.experiments.lift_ablation import METHODS
    from flows.lab.experiments.lift_ablation import ablation as ablate
    from flows.lab.experiments.lift_stress import stress as strain

    objects = objects_of(thing)
    given = [*as_given(method, rule, thing), *under(path, delay, rate, locks=locks), *of(trials, seed)]
    told_of = partial(_carry_out, out=out, as_json=as_json)
    if ablation:
        named = method or [usual.detector for usual in METHODS]
        tried = methods_of([], named, rule) if method or rule else METHODS
        broken = partial(ablate, tried, trials=trials, seed=seed, objects=objects, jobs=jobs)
        told_of("ablation", broken, ablation_page, command("lift", "--ablation", *given))
        return
    methods = methods_of([Method(DEFAULT), *BESIDE["lift"]], method, rule)
    if stress:
        strained = partial(
            strain, methods[0], trials=trials, seed=seed, objects=objects, conditions=conditions, jobs=jobs
        )
        told_of("stressing", strained, stress_page, command("lift", "--stress", *given), drawn=False)
        return
    measure = partial(
        experiment,
        "lift",
        methods,
        trials=trials,
        seed=seed,
        objects=objects,
        conditions=conditions,
        jobs=jobs,
    )
    told_of("lift", measure, page, command("lift", *given))


@app.command(epilog=examples("learn"))
def learn(
    *,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="FILE", help="The model, .safetensors; its card is the .json."),
    ] = Path("tcn_grasp.safetensors"),
    grasps: Annotated[int, typer.Option(min=20, help="Recordings of grasps to learn from.")] = 4000,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the training.")] = 2600,
    seed: Annotated[int, typer.Option(min=0, help="Of the recordings.")] = 7000,
    as_json: AsJson = False,
) -> None:
    """Train the detector of grasps.

    It learns from simulated grasps and strokes, labelled by what truly slides. None has one of the six
    objects. Stopped, it goes on where it was. Needs the train extra.
    """
    from dataclasses import replace

    from flows.lab.experiments.grasp_training import RECIPE
    from flows.lab.experiments.grasp_training import learn as train
    from flows.learn.training.learning_curve import Check

    check_output_file(out)
    with progress_bar("training tcn_grasp") as update:

        def progress(done: int, of: int, check: Check | None) -> None:
            update(done, of)
            if check:
                told(f"{check.done}: {check.accuracy:.2f} % on validation, {check.seconds:.0f} s")

        model = train(
            out, seed=seed, grasps=grasps, recipe=replace(RECIPE, steps=steps), told=told, progress=progress
        )
    scores = ", ".join(f"{each['balanced']:.2f} % on {kind}" for kind, each in model.card["scores"].items())
    summary = {"path": str(model.path), **model.card}
    typer.echo(json.dumps(summary) if as_json else f"{model.path}: balanced accuracy {scores}")


class _Pages(Protocol[Of]):
    """A module that tells what was found."""

    def write(self, of: Of, folder: Path, command: str) -> list[Path]: ...

    def summary(self, of: Of) -> dict[str, Any]: ...

    def text(self, of: Of) -> str: ...


def _carry_out(
    what: str,
    measure: "Callable[..., Found]",
    pages: _Pages[Found],
    command: str,
    out: Path,
    *,
    drawn: bool = True,
    as_json: bool,
) -> None:
    """Measure with a bar, write the page, say what was written and what it takes to have its figures."""
    from flows.report.figures import lacking
    from flows.report.report_files import make_output_folder

    make_output_folder(out)
    with progress_bar(what) as update:
        found = measure(progress=update)
    paths = pages.write(found, out, command)
    lacks = f"; figures {reason}" if drawn and (reason := lacking()) else ""
    told(f"written: {', '.join(map(str, paths))}{lacks}")
    typer.echo(json.dumps(pages.summary(found), allow_nan=False) if as_json else pages.text(found))

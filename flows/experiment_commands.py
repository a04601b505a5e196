"""The commands about the robot experiments; `flows.command` registers `app` with one line."""

import json
import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, TypeVar

import typer

from flows.options import AsJson, progress_bar, told

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from flows.experiment.experiment import Kind, Method
    from flows.experiment.setting import Conditions

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Found = TypeVar("Found")
Of = TypeVar("Of", contravariant=True)

app = typer.Typer(
    help="The paper's robot experiments on the simulated scene, closed loop.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Trials = Annotated[int, typer.Option(min=1, help="Of each object.")]
Seed = Annotated[int, typer.Option(min=0, help="Of the first trial; the next ones follow.")]
Things = Annotated[
    list[str] | None,
    typer.Option("--object", metavar="NAME", help="Only this object; may be given several times."),
]
Detectors = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="A detector by name, or a file of weights; may be given several times.",
    ),
]
Path_ = Annotated[str, typer.Option("--path", help="Of commands to the gripper: direct or mqtt.")]
Delay = Annotated[float, typer.Option(min=0, metavar="MS", help="Added between a decision and its command.")]
Rate = Annotated[float, typer.Option(min=10, max=500, metavar="HZ", help="Samples per second.")]
Locks = Annotated[
    bool, typer.Option("--locks", help="A hand that cannot grip less again, as a Robotiq 3-finger one.")
]
Sweep = Annotated[
    bool, typer.Option("--stress", help="Instead: success under friction, mass, dead cells, delay, rate.")
]
Break = Annotated[
    bool,
    typer.Option(
        "--ablation", help="Instead: where it breaks, against delay and rate, and what breaks first."
    ),
]
Jobs = Annotated[int | None, typer.Option(help="Processes; one for each core by default.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the page and its figure go.")]


@app.command()
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
    """Hit what is held with a mallet: is the slip registered, and the rest after it?

    Prints success beside the paper's, how trials failed, and what is registered where nothing slips. Writes
    tap.html, .md, .json and .svg.
    """
    from flows.experiment import page
    from flows.experiment.experiment import experiment

    measure = partial(
        experiment,
        "tap",
        _methods("tap", method, None),
        trials=trials,
        seed=seed,
        objects=_objects(thing),
        conditions=_conditions("direct", 0, rate),
        jobs=jobs,
    )
    command = _command("tap", *_given(method, None, thing), *_under(rate=rate), *_of(trials, seed))
    _carry_out("tap", measure, page, command, out, as_json=as_json)


@app.command()
def lift(
    *,
    trials: Trials = 20,
    method: Detectors = None,
    rule: Annotated[
        list[str] | None,
        typer.Option(
            help="ours, steps (the paper's) or none: how force is ruled; may be given several times."
        ),
    ] = None,
    thing: Things = None,
    seed: Seed = 900_000,
    path: Path_ = "direct",
    delay: Delay = 0.0,
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
        raise typer.BadParameter("--stress or --ablation: give one")
    conditions = _conditions(path, delay, rate, locks=locks)
    if ablation and conditions != _conditions("direct", 0, 100):
        raise typer.BadParameter("--ablation takes no --path, --delay, --rate or --locks: it tries its own")
    from flows.experiment import ablation_page, page, stress_page
    from flows.experiment.ablation import METHODS
    from flows.experiment.ablation import ablation as ablate
    from flows.experiment.experiment import experiment
    from flows.experiment.stress import stress as strain

    methods, objects = _methods("lift", method, rule), _objects(thing)
    given = [*_given(method, rule, thing), *_under(path, delay, rate, locks=locks), *_of(trials, seed)]
    if ablation:
        tried = methods if method else METHODS
        broken = partial(ablate, tried, trials=trials, seed=seed, objects=objects, jobs=jobs)
        command = _command("lift", "--ablation", *given)
        _carry_out("ablation", broken, ablation_page, command, out, as_json=as_json)
        return
    if stress:
        strained = partial(
            strain,
            methods[0],
            trials=trials,
            seed=seed,
            objects=objects,
            conditions=conditions,
            jobs=jobs,
        )
        command = _command("lift", "--stress", *given)
        _carry_out("stressing", strained, stress_page, command, out, drawn=False, as_json=as_json)
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
    _carry_out("lift", measure, page, _command("lift", *given), out, as_json=as_json)


@app.command()
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
    """Train the detector of grasps: on simulated grasps and strokes, labelled by what truly slides.

    None has one of the six objects. Stopped, it goes on where it was. Needs the train extra.
    """
    from dataclasses import replace

    from flows.experiment.learning import RECIPE
    from flows.experiment.learning import learn as train
    from flows.training.curve import Check

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
    from flows.evaluation.written import claim
    from flows.figures import lacking

    claim(out)
    with progress_bar(what) as update:
        found = measure(progress=update)
    paths = pages.write(found, out, command)
    lacks = f"; figures {reason}" if drawn and (reason := lacking()) else ""
    told(f"written: {', '.join(map(str, paths))}{lacks}")
    typer.echo(json.dumps(pages.summary(found), allow_nan=False) if as_json else pages.text(found))


def _objects(things: list[str] | None) -> "Sequence[str]":
    from connectors.rig.objects import OBJECTS

    return things or tuple(OBJECTS)


def _command(*arguments: str) -> str:
    """What makes the same page again."""
    return shlex.join(["slipflow", "experiment", *arguments])


def _given(names: list[str] | None, rules: list[str] | None, things: list[str] | None) -> list[str]:
    """The options that may be given several times, as they were."""
    options = {"--method": names, "--rule": rules, "--object": things}
    return [part for option, values in options.items() for value in values or [] for part in (option, value)]


def _under(path: str = "direct", delay: float = 0, rate: float = 100, *, locks: bool = False) -> list[str]:
    """The conditions that are not nominal, as options."""
    options = {"--path": (path, "direct"), "--delay": (f"{delay:g}", "0"), "--rate": (f"{rate:g}", "100")}
    other = [part for option, (value, usual) in options.items() if value != usual for part in (option, value)]
    return [*other, "--locks"] if locks else other


def _of(trials: int, seed: int) -> list[str]:
    return ["--trials", str(trials), "--seed", str(seed)]


def _methods(kind: "Kind", names: list[str] | None, given: list[str] | None) -> "list[Method]":
    """Each detector with each rule; by default ours beside the paper's, and no control."""
    from flows.experiment.experiment import BESIDE, DEFAULT, OURS, Method

    rules = given or [OURS]
    if names:
        return [Method(name, rule) for name in names for rule in rules]
    return [Method(DEFAULT, rule) for rule in rules] + list(BESIDE[kind])


def _conditions(path: str, delay: float, rate: float, *, locks: bool = False) -> "Conditions":
    from flows.experiment.hand import PATHS, Hand
    from flows.experiment.setting import Conditions

    if path not in PATHS:
        raise typer.BadParameter(f"--path {path}: give {' or '.join(PATHS)}")
    return Conditions(Hand(path=PATHS[path], delay=delay / 1000, locks=locks), rate=rate)

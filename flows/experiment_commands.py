"""The commands about the robot experiments; `flows.command` registers `app` with one line."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.options import AsJson, progress_bar, told

if TYPE_CHECKING:
    from flows.experiment.experiment import Kind, Method
    from flows.experiment.setting import Conditions

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

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
    _carry_out(
        "tap",
        method,
        ["ours"],
        things=thing,
        trials=trials,
        seed=seed,
        conditions=_conditions("direct", 0, rate),
        jobs=jobs,
        out=out,
        as_json=as_json,
    )


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
    jobs: Jobs = None,
    out: Out = Path("experiment"),
    as_json: AsJson = False,
) -> None:
    """Lift what is gripped too weakly: is it caught by more force?

    Prints success beside the paper's, how trials failed, how far objects slid and the force it took. Writes
    lift.html, .md, .json and .svg; with --stress lift-stress.html, .md and .json.
    """
    conditions = _conditions(path, delay, rate, locks=locks)
    rules = rule or ["ours"]
    if not stress:
        _carry_out(
            "lift",
            method,
            rules,
            things=thing,
            trials=trials,
            seed=seed,
            conditions=conditions,
            jobs=jobs,
            out=out,
            as_json=as_json,
        )
        return
    from flows.evaluation.written import claim
    from flows.experiment import stress_page
    from flows.experiment.stress import stress as measure

    claim(out)
    chosen = _methods("lift", method, rules)[0]
    with progress_bar("stressing") as update:
        found = measure(chosen, trials=trials, seed=seed, conditions=conditions, jobs=jobs, progress=update)
    paths = stress_page.write(
        found, out, f"slipflow experiment lift --stress --trials {trials} --seed {seed}"
    )
    told(f"written: {', '.join(map(str, paths))}")
    typer.echo(json.dumps(found.json()) if as_json else stress_page.text(found))


@app.command()
def learn(
    *,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="FILE", help="The model, .safetensors; its card is the .json."),
    ] = Path("tcn_grasp.safetensors"),
    grasps: Annotated[int, typer.Option(min=20, help="Recordings of grasps to learn from.")] = 2000,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the training.")] = 4000,
    seed: Annotated[int, typer.Option(min=0, help="Of the recordings.")] = 7000,
    as_json: AsJson = False,
) -> None:
    """Train the detector of grasps: on simulated grasps and strokes, labelled by what truly slides.

    None has one of the six objects. Stopped, it goes on where it was. Needs the train extra.
    """
    from flows.experiment.learning import learn as train
    from flows.networks.recipe import Recipe
    from flows.training.curve import Check

    with progress_bar("training tcn_grasp") as update:

        def progress(done: int, of: int, check: Check | None) -> None:
            update(done, of)
            if check:
                told(f"{check.done}: {check.accuracy:.2f} % on validation, {check.seconds:.0f} s")

        model = train(out, seed=seed, grasps=grasps, recipe=Recipe(steps=steps), told=told, progress=progress)
    scores = ", ".join(f"{each['balanced']:.2f} % on {kind}" for kind, each in model.card["scores"].items())
    summary = {"path": str(model.path), **model.card}
    typer.echo(json.dumps(summary) if as_json else f"{model.path}: balanced accuracy {scores}")


def _carry_out(
    kind: "Kind",
    names: list[str] | None,
    rules: list[str],
    *,
    things: list[str] | None,
    trials: int,
    seed: int,
    conditions: "Conditions",
    jobs: int | None,
    out: Path,
    as_json: bool,
) -> None:
    from connectors.rig.objects import OBJECTS
    from flows.evaluation.written import claim
    from flows.experiment import page
    from flows.experiment.experiment import experiment

    claim(out)
    methods = _methods(kind, names, rules)
    with progress_bar(kind) as update:
        found = experiment(
            kind,
            methods,
            trials=trials,
            seed=seed,
            objects=things or tuple(OBJECTS),
            conditions=conditions,
            jobs=jobs,
            progress=update,
        )
    given = "".join(f" --method {name}" for name in dict.fromkeys(method.detector for method in methods))
    paths = page.write(found, out, f"slipflow experiment {kind}{given} --trials {trials} --seed {seed}")
    told(f"written: {', '.join(map(str, paths))}")
    typer.echo(json.dumps(page.summary(found)) if as_json else page.text(found))


def _methods(kind: "Kind", names: list[str] | None, rules: list[str]) -> "list[Method]":
    """Each detector with each rule; by default ours beside the paper's, and no control."""
    from flows.experiment.experiment import BESIDE, DEFAULT, Method

    if names:
        return [Method(name, rule) for name in names for rule in rules]
    return [Method(DEFAULT, rule) for rule in rules] + list(BESIDE[kind])


def _conditions(path: str, delay: float, rate: float, *, locks: bool = False) -> "Conditions":
    from flows.experiment.hand import PATHS, Hand
    from flows.experiment.setting import Conditions

    if path not in PATHS:
        raise typer.BadParameter(f"--path {path}: give {' or '.join(PATHS)}")
    return Conditions(Hand(path=PATHS[path], delay=delay / 1000, locks=locks), rate=rate)

"""The options of the robot experiments, what they mean, and how they are written again."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from flows.lab.experiments.experiment import Method
    from flows.lab.experiments.trial_setting import Conditions

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Trials = Annotated[int, typer.Option(min=1, help="How many, of each object.")]
Seed = Annotated[int, typer.Option(min=0, help="Of the first trial; the next ones follow.")]
Things = Annotated[
    list[str] | None,
    typer.Option(
        "--object",
        metavar="NAME",
        help="Only this object: box, ball, cardboard_can, football_sleeve, foam_sleeve or metal_can; may be"
        " given several times.",
    ),
]
Detectors = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="Only this detector, by name or as a file of weights; may be given several times.",
    ),
]
Rules = Annotated[
    list[str] | None,
    typer.Option(
        "--rule",
        metavar="NAME",
        help="Only this rule of the force: ours, steps (the paper's) or none; may be given several times.",
    ),
]
Way = Annotated[str, typer.Option("--path", help="Of commands to the gripper: direct or mqtt.")]
Delay = Annotated[
    str, typer.Option(metavar="TIME", help="Added between a decision and its command, as 50ms.")
]
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
Jobs = Annotated[int | None, typer.Option(min=1, help="Processes; one for each core by default.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the page and its figure go.")]


def objects_of(things: list[str] | None) -> "Sequence[str]":
    """The objects that are named; all of them where none is."""
    from connectors.sim.objects import OBJECTS

    return things or tuple(OBJECTS)


def command(*arguments: str) -> str:
    """What makes the same page again."""
    return shlex.join(["slipflow", "experiment", *arguments])


def as_given(names: list[str] | None, rules: list[str] | None, things: list[str] | None) -> list[str]:
    """The options that may be given several times, as they were."""
    options = {"--method": names, "--rule": rules, "--object": things}
    return [part for option, values in options.items() for value in values or [] for part in (option, value)]


def under(path: str = "direct", delay: str = "0s", rate: float = 100, *, locks: bool = False) -> list[str]:
    """The conditions that are not nominal, as options."""
    options = {"--path": (path, "direct"), "--delay": (delay, "0s"), "--rate": (f"{rate:g}", "100")}
    other = [part for option, (value, usual) in options.items() if value != usual for part in (option, value)]
    return [*other, "--locks"] if locks else other


def of(trials: int, seed: int) -> list[str]:
    """Trials and their seed, as options."""
    return ["--trials", str(trials), "--seed", str(seed)]


def methods_of(usual: "Sequence[Method]", names: list[str] | None, rules: list[str] | None) -> "list[Method]":
    """Each detector that is named, with each rule; where none is, the usual ones that follow those rules."""
    from flows.lab.experiments.experiment import OURS, RULES, Method

    for rule in rules or ():
        if rule not in RULES:
            raise typer.BadParameter(f"--rule {rule}: give one of {', '.join(RULES)}")
    if names:
        return [Method(name, rule) for name in names for rule in rules or [OURS]]
    return [method for method in usual if not rules or method.rule in rules]


def conditions_of(path: str, delay: str, rate: float, *, locks: bool = False) -> "Conditions":
    """What all trials share.

    Raises:
        ParameterError: if the delay is no time.
    """
    from flows.graph.quantity import time
    from flows.lab.experiments.hand_model import PATHS, Hand
    from flows.lab.experiments.trial_setting import Conditions

    if path not in PATHS:
        raise typer.BadParameter(f"--path {path}: give {' or '.join(PATHS)}")
    return Conditions(
        Hand(path=PATHS[path], delay=time("lift", "--delay", delay) / 1e9, locks=locks), rate=rate
    )

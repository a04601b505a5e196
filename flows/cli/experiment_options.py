"""Options that the experiment commands share."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from flows.lab.experiments.study import Method, Trials

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
Jobs = Annotated[int | None, typer.Option(min=1, help="Number of processes (default: one per core).")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the report and its figure.")]
_OUTPUT = ("jobs", "out", "as_json")  # parameters that do not change the results


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

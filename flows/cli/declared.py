"""The flow that a command is about: how it is named, and its parameters set."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from flows.graph import Flow

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Target = Annotated[
    str,
    typer.Argument(
        metavar="FILE[:FLOW]",
        help="A Python file that declares a flow (run as code), or one of lift, live, record, relabel.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Set a parameter of the flow, as delay=70ms; `slipflow check` lists them; may be given several"
        " times.",
    ),
]


def named_settings(settings: list[str] | None) -> dict[str, str]:
    """What was given with --set, by name.

    >>> named_settings(["seed=1", "delay=70ms"])
    {'seed': '1', 'delay': '70ms'}
    """
    pairs = [setting.partition("=") for setting in settings or ()]
    for name, equals, _ in pairs:
        if not (name and equals):
            raise typer.BadParameter(f"--set {name}: write it as NAME=VALUE, such as seed=1")
    return {name: value for name, _, value in pairs}


def declared(target: str, settings: list[str] | None) -> "Flow":
    """The flow that was named, its parameters set.

    Raises:
        InputError: if there is no such flow.
        ParameterError: on a setting that it cannot take.
    """
    from flows.graph.loading import load

    return load(target).flow(named_settings(settings))

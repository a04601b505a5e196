"""The commands that look at a flow without running it."""

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.declared import Settings, Target, declared, named_settings
from flows.cli.options import AsJson

if TYPE_CHECKING:
    from flows.graph.node import Node

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415


def check(target: Target, *, settings: Settings = None, as_json: AsJson = False) -> None:
    """Find what is wrong with a flow without running it.

    Lists its parameters as they are set or else by default, ready for --set. Exits 2 if anything is wrong.
    """
    from flows.graph.loading import load
    from flows.graph.validation import problems

    declaration = load(target)
    chosen = named_settings(settings)
    flow = declaration.flow(chosen)
    found = [str(problem) for problem in problems(flow)]
    if as_json:
        parameters = {name: each.as_dict() for name, each in declaration.parameters.items()}
        typer.echo(json.dumps({"flow": flow.name, "problems": found, "parameters": parameters}))
    elif found:
        typer.echo("\n".join(f"error: {problem}" for problem in found), err=True)
    else:
        typer.echo(f"{flow.name} is sound; sources: {_names(flow.sources())}; sinks: {_names(flow.sinks())}")
        for name, each in declaration.parameters.items():
            value = each.value(flow.name, chosen[name]) if name in chosen else each.default
            typer.echo(f"  --set {replace(each, default=value)}")
    if found:
        raise typer.Exit(2)


def graph(
    target: Target,
    *,
    settings: Settings = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid flowchart.")] = False,
) -> None:
    """Print a flow as text or, with --mermaid, as a flowchart."""
    from flows.graph import drawing

    flow = declared(target, settings)
    typer.echo(drawing.mermaid(flow.nodes) if mermaid else flow)


def _names(nodes: "list[Node]") -> str:
    return ", ".join(node.name for node in nodes)

"""The command `slipflow check`."""

from dataclasses import replace

import typer

from flows.cli.options import Settings, Target, parse_settings
from flows.cli.terminal import begin_log


def check(target: Target, *, settings: Settings = None) -> None:
    """Find errors in a flow without running it, and print it.

    Prints the graph, and the parameters with their values, and compiles the operators and simulated sources,
    so that the first run need not. Exits 2 if there are errors.

    Examples:
      slipflow check record --set delay=70ms
      slipflow check grip.py:gentle
    """
    from flows.graph.compiled_flow import CompiledFlow
    from flows.graph.loading import load
    from flows.graph.validation import problems

    declaration = load(target)
    chosen = parse_settings(settings)
    flow = declaration.flow(chosen)
    live = all(source.recording is None for source in flow.sources().values())
    found = [str(problem) for problem in problems(flow, fingertips=live)]  # a recording is read by a run only
    if found:
        typer.echo("\n".join(f"error: {problem}" for problem in found), err=True)
        raise typer.Exit(2)
    typer.echo(flow)
    if live:
        begin_log()
        CompiledFlow(flow)
    sources, sinks = (", ".join(node.name for node in nodes) for nodes in (flow.sources(), flow.sinks()))
    typer.echo(f"{flow.name}: OK (sources: {sources}; sinks: {sinks})")
    for name, each in declaration.parameters.items():
        value = each.value(flow.name, chosen[name]) if name in chosen else each.default
        typer.echo(f"  --set {replace(each, default=value)}")
        if each.about:
            typer.echo(f"      {each.about}")

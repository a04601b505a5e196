"""The command `slipflow graph`."""

from typing import Annotated

import typer

from flows.cli.options import Settings, Target, load_flow


def graph(
    target: Target,
    *,
    settings: Settings = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Print a Mermaid flowchart.")] = False,
) -> None:
    """Print a flow as text or, with --mermaid, as a flowchart.

    Examples:
      slipflow graph record
      slipflow graph grip.py --mermaid
    """
    from flows.graph import drawing

    flow = load_flow(target, settings)
    typer.echo(drawing.mermaid(flow.nodes) if mermaid else flow)

"""Measuring a flow as it runs: the option of the commands that can, and wiring it up."""

from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.listening import listening
from flows.cli.options import told

if TYPE_CHECKING:
    from collections.abc import Callable

    from flows.graph import Flow

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

WithMetrics = Annotated[
    str | None,
    typer.Option(
        "--metrics",
        metavar="[HOST:]PORT",
        help="Serve its numbers for Prometheus, as 9464: on this machine only, unless a host is given.",
    ),
]


def add_metrics(flow: "Flow", listen: str, opened: "Callable[[str], None] | None" = None) -> None:
    """Serve the metrics of a flow's run, with what its slips, faults and clocks tell; tell the address.

    Of several streams of one type the first counts.

    Args:
        flow: Gains a sink, which takes nothing where the flow has no such stream.
        listen: As ``[HOST:]PORT``.
        opened: Told the address; by default it is printed.
    """
    from connectors import Metrics
    from operators import Clocks, Faults, Slips

    host, port = listening("--metrics", listen)
    inputs = [
        next((node for node in flow.nodes if node.gives is kind), None) for kind in (Slips, Faults, Clocks)
    ]
    metrics = Metrics(port, host, opened=opened or (lambda url: told(f"metrics: {url}")))
    flow.add("metrics", metrics, *filter(None, inputs))

"""The command that shows what slipflow does with nothing attached."""

import asyncio
import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.event_log import Format, Log, in_json
from flows.cli.execution import Duration, apart_from, execute
from flows.cli.live_metrics import WithMetrics, add_metrics
from flows.cli.live_page import Listen, NoBrowser, WithPage, add_page
from flows.cli.options import AsJson

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415


def demo(
    *,
    duration: Duration = "20s",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset to record into.")] = Path("recordings"),
    mqtt: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Publish to this broker; without, to one found on localhost."),
    ] = None,
    rig: Annotated[
        str, typer.Option(metavar="NAME", help="What it is called in topics; each its own outbox.")
    ] = "demo",
    outbox: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Keeps the events for the broker; by default one for each rig."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of all noise of the simulated rig.")] = 0,
    page: WithPage = True,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: WithMetrics = None,
    log: Log = Format.TEXT,
    as_json: AsJson = False,
) -> None:
    """Run the main job with nothing attached, on a simulated rig.

    It feels slip, records a labelled dataset, shows both on a page, and publishes events where a broker is.
    Exits 1 if a source was down at the end or rows were lost.
    """
    from flows import demo as ready_made
    from flows.cli import demo_summary
    from flows.graph.quantity import time
    from flows.run.run_summary import Summary

    limit = None if duration is None else time("demo", "--for", duration)  # ns
    broker = mqtt or demo_summary.local_broker()
    flow = ready_made.demo(str(out), broker, rig, outbox, seed, connect_required=bool(mqtt))
    if log is Format.JSON:
        flow = in_json(flow)
    if page:
        add_page(flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow, metrics)
    typer.echo(flow, err=True)
    typer.echo("starting; the first time, the simulated physics is compiled for some seconds", err=True)
    with apart_from(result=as_json, log=log):
        done = asyncio.run(execute(flow, log=log, limit=limit))
    summary = Summary.of(done)
    if as_json:
        found = demo_summary.summarize(flow, done, out, broker)
        typer.echo(json.dumps({**summary.as_dict(), **found}))
    elif log is Format.TEXT:
        typer.echo(demo_summary.report(demo_summary.summarize(flow, done, out, broker), done))
    if summary.lost:
        raise typer.Exit(1)

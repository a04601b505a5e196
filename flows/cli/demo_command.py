"""The command `slipflow demo`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.event_log import Format, Log, begin_log, with_json_console
from flows.cli.execution import execute, separate_result
from flows.cli.live_view import Listen, Metrics, NoBrowser, WithPage, add_metrics, add_page
from flows.cli.options import AsJson, Recordings, Seed


def demo(
    *,
    duration: Annotated[
        str | None, typer.Option("--for", metavar="TIME", help="Stop after this time, such as 30s or 5min.")
    ] = "20s",
    out: Recordings = Path("recordings"),
    mqtt: Annotated[
        str | None,
        typer.Option(metavar="URL", help="MQTT broker to publish to (default: one on this machine, if any)."),
    ] = None,
    rig: Annotated[
        str, typer.Option(metavar="NAME", help="Rig name used in topics; each name has its own outbox.")
    ] = "demo",
    outbox: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder that keeps the published events (default: one per rig)."),
    ] = None,
    seed: Seed = 0,
    page: WithPage = True,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: Metrics = None,
    log: Log = Format.TEXT,
    as_json: AsJson = False,
) -> None:
    """Detect slip on a simulated rig; no hardware is needed.

    Records a labelled dataset, shows touch and slips on the live page, and publishes events if there is a
    broker. Exits 1 if a source was down or silent at the end, or rows were lost.

    Examples:
      slipflow demo --for 1min
      slipflow demo --mqtt mqtt://localhost --rig left --no-page
    """
    from connectors.punctual_loop import run_punctually
    from flows import demo as declared
    from flows.cli import demo_summary
    from flows.graph.quantity import parse_time
    from flows.run.run_summary import Summary

    begin_log(log)
    limit = None if duration is None else parse_time("demo", "--for", duration)  # ns
    broker = mqtt or demo_summary.local_broker()
    flow = declared.demo(str(out), broker, rig, outbox, seed, connect_required=bool(mqtt))
    if log is Format.JSON:
        flow = with_json_console(flow)
    if page:
        add_page(flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow, metrics)
    typer.echo(flow, err=True)
    with separate_result(as_json=as_json, log=log):
        done = run_punctually(execute(flow, limit=limit))
    summary = Summary.of(done)
    found = demo_summary.summarize(done, out, broker)
    if as_json:
        typer.echo(json.dumps({**summary.as_dict(), **found}))
    elif log is Format.TEXT:
        typer.echo(demo_summary.report(found, done))
    if summary.lost:
        raise typer.Exit(1)

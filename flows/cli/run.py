"""The command `slipflow run`."""

import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.event_log import Format, begin_log
from flows.cli.execution import execute, replay_all, report_run
from flows.cli.live_view import add_metrics, add_page, print_json
from flows.cli.options import (
    AsJson,
    Cluster,
    Duration,
    Jobs,
    Listen,
    Log,
    NoBrowser,
    Settings,
    Target,
    load_flow,
    parse_settings,
)
from flows.cli.terminal import note


def run(
    target: Target,
    *,
    settings: Settings = None,
    duration: Duration = None,
    replay: Annotated[
        list[Path] | None,
        typer.Option(metavar="PATH", help="Replay a session, a dataset, or a trace (.csv, .parquet)."),
    ] = None,
    more: Annotated[
        list[Path] | None, typer.Argument(metavar="PATH", help="Further recordings, with --replay.")
    ] = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    pace: Annotated[
        float | None,
        typer.Option(min=0.01, help="Replay at this multiple of real time (default: full speed)."),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Serve the live page and open it in a browser.")
    ] = False,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="Serve Prometheus metrics, at 9464 for example. A HOST that other machines reach needs"
            " SLIPFLOW_PAGE_TOKEN, their bearer token.",
        ),
    ] = None,
    log: Log = Format.TEXT,
    as_json: AsJson = False,
) -> None:
    """Run a flow live, or replay recordings through it.

    A live run ends with its sources, after --for, or at Ctrl-C. Recordings are replayed in parallel, each to
    a session of its name; a repeated command omits those that exist. Exits 1 if a source was down or silent
    at the end, rows were lost, or a replay failed; the others continue.

    Examples:
      slipflow run live --for 30s --page
      slipflow run record --set out=lab --set delay=70ms
      slipflow run relabel --replay recordings --jobs 4
      slipflow run relabel --replay recordings --cluster tcp://127.0.0.1:8786
      slipflow run grip.py:gentle --replay trace.csv --pace 1
    """
    from connectors.punctual_loop import run_punctually
    from flows.graph.quantity import parse_time
    from flows.run.replays import check_outputs, open_recording, recordings

    at_full_speed = {"--jobs": jobs, "--cluster": cluster, "a further recording": more}
    if replay and pace is None:
        json_log = log is Format.JSON
        in_real_time = {"--for": duration, "--page": page, "--listen": listen, "--metrics": metrics}
        _refuse({**in_real_time, "--log json": json_log}, "a run in real time: add --pace 1")
        begin_log(log)
        paths = [*replay, *(more or ())]
        replay_all(target, parse_settings(settings), paths, jobs=jobs, cluster=cluster, as_json=as_json)
        return
    _refuse(at_full_speed, "replays at full speed: " + ("omit --pace" if replay else "add --replay PATH"))
    _refuse({"--pace": pace if not replay else None}, "replays: add --replay PATH")
    limit = None if duration is None else parse_time("run", "--for", duration)  # ns
    begin_log(log)
    flow = load_flow(target, settings)
    paths = recordings(replay or ())
    if len(paths) > 1:
        raise typer.BadParameter("--pace is for a single recording: name one session of the dataset")
    check_outputs(flow, paths)
    recording = open_recording(paths[0], note) if paths else None
    if log is Format.JSON:
        print_json(flow)
    if page or listen:
        add_page(flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow, metrics)
    with redirect_stdout(sys.stderr if as_json and log is Format.TEXT else sys.stdout):
        done = run_punctually(execute(flow, limit=limit, recording=recording, pace=pace or 1.0))
    report_run(done, log=log, as_json=as_json)


def _refuse(options: Mapping[str, object], purpose: str) -> None:
    """Raise an error that names the first option with a value, and what it is for."""
    for name, value in options.items():
        if value:
            raise typer.BadParameter(f"{name} is for {purpose}")

"""The command that runs a flow."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from flows.commands import on_cluster, replays
from flows.commands.declared import Settings, Target, declared, named_settings
from flows.commands.event_log import Format, Log, in_json
from flows.commands.execution import Duration, execute, finish, session_name
from flows.commands.live_metrics import WithMetrics, add_metrics
from flows.commands.live_page import Listen, NoBrowser, WithPage, add_page
from flows.commands.on_cluster import Follow, OnCluster, WithPython
from flows.commands.options import AsJson, told

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415


def run(
    target: Target,
    *,
    settings: Settings = None,
    duration: Duration = None,
    replay: Annotated[
        list[Path] | None,
        typer.Option(metavar="PATH", help="Run over a session, all of a dataset or a CSV trace instead."),
    ] = None,
    more: Annotated[
        list[Path] | None, typer.Argument(metavar="PATH", help="With --replay: further recordings.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Processes that replay recordings; one for each core by default."),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(
            min=0.01, help="Replay at this multiple of real time, 1 as it came; else at full speed."
        ),
    ] = None,
    cluster: OnCluster = None,
    python: WithPython = None,
    follow: Follow = False,
    page: WithPage = False,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: WithMetrics = None,
    log: Log = Format.TEXT,
    as_json: AsJson = False,
) -> None:
    """Run a flow: live, or over a recording with --replay.

    Ends when its sources end, after --for, or at Ctrl-C, and commits what it took; exits 1 if a source was
    down at the end or rows were lost.

    Several recordings are replayed side by side, each to a session of its own, its lines below its name; one
    that fails is reported, the others go on, and it exits 1.

    With --json a live run is one object: session, flow, seconds, sources, sinks, error. A replay, of one
    recording or of many, is {"sessions": [...], "wall_seconds": ...}, with that and "recording" for each.
    """
    from time import perf_counter

    from flows.quantity import time
    from flows.running.parallel_replay import apart, open_recording, recordings

    limit = None if duration is None else time("run", "--for", duration)  # ns
    flow = declared(target, settings)
    if replay is None and (pace is not None or jobs is not None or more):
        raise typer.BadParameter(
            "--pace, --jobs and further recordings need --replay PATH: without it a flow runs live"
        )
    if not cluster:
        _check_replay(
            full_speed=bool(replay) and pace is None, timed=bool(duration), clustered=bool(follow or python)
        )
    given = [*(replay or ()), *(more or ())]
    if cluster:
        if metrics or log is not Format.TEXT:
            raise typer.BadParameter(
                "--metrics and --log are of a run on this machine: leave them out with --cluster"
            )
        at = on_cluster.Place(cluster, python, follow=follow, limit=limit)
        at.run(target, named_settings(settings), given, session_name(flow), as_json=as_json)
        return
    paths = recordings(given)
    apart(flow, paths)
    if len(paths) > 1:
        if pace is not None or page or listen or metrics or log is not Format.TEXT:
            raise typer.BadParameter(
                "--pace, --page, --metrics and --log take one recording: leave them out, or give one"
            )
        replays.replay(target, named_settings(settings), paths, session_name(flow), jobs, in_json=as_json)
        return
    recording = open_recording(paths[0], told) if paths else None
    if log is Format.JSON:
        flow = in_json(flow)
    if page or listen:
        add_page(flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow, metrics)
    began = perf_counter()
    done = asyncio.run(execute(flow, recording, limit, pace, log))
    finish(done, paths, perf_counter() - began, log, as_json=as_json)


def _check_replay(*, full_speed: bool, timed: bool, clustered: bool) -> None:
    """Say which options do not go together on this machine."""
    if clustered:
        raise typer.BadParameter("--follow and --cluster-python need --cluster URL")
    if full_speed and timed:
        raise typer.BadParameter("--for is of live runs and of --pace: a replay ends with its recording")

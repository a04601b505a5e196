"""The command that runs a flow."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from flows.cli import on_cluster, replays
from flows.cli.declared import Settings, Target, declared, named_settings
from flows.cli.event_log import Format, Log, in_json
from flows.cli.execution import Duration, apart_from, execute, finish, session_name
from flows.cli.live_metrics import WithMetrics, add_metrics
from flows.cli.live_page import Listen, NoBrowser, WithPage, add_page
from flows.cli.on_cluster import Follow, OnCluster, WithPython
from flows.cli.options import AsJson, told

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

    from flows.graph.quantity import time
    from flows.run.parallel_replay import apart, open_recording, recordings

    limit = None if duration is None else time("run", "--for", duration)  # ns
    single = bool(pace is not None or page or listen or metrics or log is not Format.TEXT)
    _check_together(
        (
            replay is None and bool(pace is not None or jobs is not None or more),
            "--pace, --jobs and further recordings need --replay PATH: without it a flow runs live",
        ),
        (
            bool(cluster) and (single or jobs is not None),
            "--cluster: leave out --pace, --jobs, --page, --metrics and --log, of runs on this machine",
        ),
        (not cluster and bool(follow or python), "--follow and --cluster-python need --cluster URL"),
        (
            bool(replay and duration) and pace is None and not cluster,
            "--for is of live runs and of --pace: a replay ends with its recording",
        ),
    )
    flow = declared(target, settings)
    given = [*(replay or ()), *(more or ())]
    if cluster:
        at = on_cluster.Place(cluster, python, follow=follow, limit=limit)
        at.run(target, named_settings(settings), given, session_name(flow), as_json=as_json)
        return
    paths = recordings(given)
    apart(flow, paths)
    if len(paths) > 1:
        _check_together(
            (single, "--pace, --page, --metrics and --log take one recording: leave them out, or give one")
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
    with apart_from(result=as_json, log=log):
        done = asyncio.run(execute(flow, log=log, limit=limit, recording=recording, pace=pace))
    replayed, seconds = next(iter(paths), None), perf_counter() - began
    finish(done, replayed=replayed, seconds=seconds, log=log, as_json=as_json)


def _check_together(*cases: tuple[bool, str]) -> None:
    """Make sure that no case holds of options that do not go together.

    Raises:
        BadParameter: saying why, if one does.
    """
    for holds, why in cases:
        if holds:
            raise typer.BadParameter(why)

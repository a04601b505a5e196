"""The command `slipflow run`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.event_log import Format, Log, begin_log, with_json_console
from flows.cli.execution import execute, report_run, separate_result, session_name
from flows.cli.live_view import Listen, Metrics, NoBrowser, WithPage, add_metrics, add_page
from flows.cli.options import AsJson, Duration, Jobs, Settings, Target, load_flow, parse_settings
from flows.cli.replay_batch import replay_all
from flows.cli.run_on_cluster import ClusterUrl, Follow, PythonFile, run_on_cluster
from flows.cli.terminal import note


def run(
    target: Target,
    *,
    settings: Settings = None,
    duration: Duration = None,
    replay: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="PATH",
            help="Replay a session, all sessions of a dataset, or a trace: .csv or .parquet.",
        ),
    ] = None,
    more: Annotated[
        list[Path] | None, typer.Argument(metavar="PATH", help="Further recordings, with --replay.")
    ] = None,
    jobs: Jobs = None,
    pace: Annotated[
        float | None,
        typer.Option(
            min=0.01, help="Replay at this multiple of real time; 1 is real time (default: full speed)."
        ),
    ] = None,
    cluster: ClusterUrl = None,
    python: PythonFile = None,
    follow: Follow = False,
    page: WithPage = False,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: Metrics = None,
    log: Log = Format.TEXT,
    as_json: AsJson = False,
) -> None:
    """Run a flow live, or replay recordings through it.

    Ends when the sources end, after --for, or at Ctrl-C, and commits what was recorded. Exits 1 if a source
    was down or silent at the end, or rows were lost.

    Several recordings are replayed in parallel, each to its own session, with its output under its name. If
    one fails, the error is reported, the others continue, and the exit code is 1.

    With --json a live run prints one object: session, flow, seconds, sources, sinks, error. A replay prints
    {"sessions": [...], "wall_seconds": ...}; each session also has "recording".

    Examples:
      slipflow run live --for 30s --page
      slipflow run record --set out=lab --set delay=70ms
      slipflow run live --replay recordings --json
      slipflow run grip.py:gentle --replay trace.csv --pace 1
    """
    from time import perf_counter

    from connectors.punctual_loop import run_punctually
    from flows.graph.quantity import parse_time
    from flows.run.parallel_replay import check_outputs, open_recording, recordings

    limit = None if duration is None else parse_time("run", "--for", duration)  # ns
    single = bool(pace is not None or page or listen or metrics or log is not Format.TEXT)
    _check_options(
        (
            replay is not None or not (pace is not None or jobs is not None or more),
            "--pace, --jobs and further recordings require --replay PATH: without it a flow runs live",
        ),
        (
            not (cluster and (single or jobs is not None)),
            "--cluster: omit --pace, --jobs, --page, --metrics and --log, which are for this machine only",
        ),
        (bool(cluster) or not (follow or python), "--follow and --cluster-python require --cluster URL"),
        (
            not (replay and duration) or pace is not None or bool(cluster),
            "--for requires a live run or --pace: a replay at full speed ends with its recording",
        ),
    )
    begin_log(log)
    flow = load_flow(target, settings)
    given = [*(replay or ()), *(more or ())]
    if cluster:
        run_on_cluster(
            cluster,
            python,
            target,
            parse_settings(settings),
            given,
            job=session_name(flow),
            follow=follow,
            limit=limit,
            as_json=as_json,
        )
        return
    paths = recordings(given)
    check_outputs(flow, paths)
    if len(paths) > 1:
        _check_options((not single, "--pace, --page, --metrics and --log require a single recording"))
        replay_all(target, parse_settings(settings), paths, session_name(flow), jobs, as_json=as_json)
        return
    recording = open_recording(paths[0], note) if paths else None
    if log is Format.JSON:
        flow = with_json_console(flow)
    if page or listen:
        add_page(flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow, metrics)
    began = perf_counter()
    with separate_result(as_json=as_json, log=log):
        done = run_punctually(execute(flow, limit=limit, recording=recording, pace=pace))
    replayed, seconds = next(iter(paths), None), perf_counter() - began
    report_run(done, replayed=replayed, seconds=seconds, log=log, as_json=as_json)


def _check_options(*checks: tuple[bool, str]) -> None:
    """Raise an error with the message of the first check that failed."""
    for passed, message in checks:
        if not passed:
            raise typer.BadParameter(message)

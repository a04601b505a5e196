"""The command `slipflow run`: a flow live, or over recordings, and the report of its result."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.live_view import add_metrics, add_page
from flows.cli.options import (
    Cluster,
    Duration,
    Jobs,
    Listen,
    NoBrowser,
    Settings,
    Target,
    load_flow,
    parse_settings,
)
from flows.cli.terminal import begin_log, note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from flows.graph import Flow
    from flows.run.replays import Replayed
    from operators.ports import Run


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
    page: Annotated[
        bool, typer.Option("--page", help="Serve the live page and open it in a browser.")
    ] = False,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="Serve Prometheus metrics, for example at 9464. For other machines set SLIPFLOW_PAGE_TOKEN,"
            " the bearer token, and HOST to 0.0.0.0.",
        ),
    ] = None,
) -> None:
    """Run a flow live, or replay recordings through it.

    A live run ends with its sources, after --for, or at Ctrl-C. Recordings are replayed in parallel, each to
    a session of its name; a repeated command leaves out those that exist. Exits 1 if a source was down or
    silent at the end, most of its rows were late, a sink dropped rows, or one of several replays failed; the
    other replays continue.

    Examples:
      slipflow run live --for 30s --page
      slipflow run record --set out=lab --set delay=70ms
      slipflow run relabel --replay recordings --jobs 4
      slipflow run relabel --replay recordings --cluster tcp://127.0.0.1:8786
      slipflow run grip.py:gentle --replay trace.csv
    """
    from flows.graph.quantity import parse_quantity
    from flows.graph.validation import validate

    if replay:
        live = {"--for": duration, "--page": page, "--listen": listen, "--metrics": metrics}
        _refuse(live, "live runs: omit it (slipflow show shows a recording)")
        begin_log()
        paths = [*replay, *(more or ())]
        replay_all(target, parse_settings(settings), paths, jobs=jobs, cluster=cluster)
        return
    replays = {"--jobs": jobs, "--cluster": cluster, "a further recording": more}
    _refuse(replays, "replays: add --replay PATH")
    limit = None if duration is None else int(parse_quantity("run", "--for", duration, "ns"))
    begin_log()
    flow = load_flow(target, settings)
    validate(flow)
    if page or listen:
        add_page(flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow, metrics)
    report_run(execute(flow, limit))


def _refuse(options: Mapping[str, object], reason: str) -> None:
    """Raise an error if an option is given, by its name."""
    for name, value in options.items():
        if value:
            raise typer.BadParameter(f"{name} is for {reason}")


def execute(flow: "Flow", limit: int | None = None) -> "Run":
    """Run a flow live, for `limit` ns at most."""
    import asyncio
    from datetime import UTC, datetime

    from flows.graph.compiled_flow import CompiledFlow
    from flows.run.live_runner import LiveRunner
    from flows.run.supervision import signals_to

    async def live() -> "Run":
        session = f"{flow.name}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z"
        runner = LiveRunner(flow, session, duration=limit)
        with signals_to(runner.stop):
            return await runner.execute()

    CompiledFlow(flow)  # here Ctrl-C ends a compilation at once; an event loop would complete it first
    return asyncio.run(live())


def report_run(run: "Run") -> None:
    """Print the result of a run; exit 130 if it was interrupted, 1 if it lost something."""
    from flows.run.run_summary import Summary

    summary = Summary.of(run)
    typer.echo(summary.report())
    if run.error:
        raise typer.Exit(130)
    if summary.error:
        raise typer.Exit(1)


def replay_all(
    target: str, settings: Mapping[str, str], paths: Sequence[Path], *, jobs: int | None, cluster: str | None
) -> None:
    """Replay recordings, each to a session of its name, and print the results in their order.

    Sessions that exist already are omitted. Exits 1 if a replay failed or lost rows; Ctrl-C ends all replays
    and exits 130.

    Raises:
        SlipflowError: if the only recording fails, or nothing can be replayed.
    """
    from time import perf_counter

    from flows.run.executor import workers
    from flows.run.replays import FlowSource, Replays
    from operators.errors import SlipflowError

    replays = Replays(FlowSource(target, tuple(settings.items())), paths)
    if existing := len(replays.existing):
        note(f"{counted(existing, 'recording')} of {existing + len(replays.recordings)} replayed already")
    if jobs is None and cluster is None and (exclusive := replays.exclusive_sinks):
        jobs = 1
        if len(replays.recordings) > 1:
            note(f"replaying one recording at a time: only one process can write to {', '.join(exclusive)}")
    began, done = perf_counter(), list["Replayed"]()
    with workers(jobs, cluster) as executor, progress_bar(f"replaying {target}") as update:
        try:
            for each in replays.run(executor, progress=update):
                if each.error and len(replays.recordings) == 1:
                    typer.echo(each.printed, nl=False)
                    raise SlipflowError(each.error)
                done.append(each)
                _print(each)
        except KeyboardInterrupt:
            note("interrupted: repeat the command to continue with the missing sessions")
            raise
    seconds = perf_counter() - began
    summaries = [each.summary for each in done if each.summary]
    failed = sum(bool(each.error) for each in done)
    rows = counted(sum(one.rows for each in summaries for one in each.sources.values()), "row")
    failures = f"; {failed} failed" if failed else ""
    typer.echo(f"{counted(len(done), 'recording')}, {rows} in {seconds:.1f} s{failures}")
    if failed or any(each.error for each in summaries):
        raise typer.Exit(1)


def _print(done: "Replayed") -> None:
    """Print the output of a replay."""
    line, error = f"{done.recording}:", done.error
    if found := done.summary:
        sources = ", ".join(f"{source.rows:,} {name}" for name, source in found.sources.items())
        sinks = ", ".join(f"{sink.rows:,} to {name}" for name, sink in found.sinks.items())
        line = f"{done.recording} -> {found.session}: {found.seconds:.1f} s, {sources}; {sinks}"
        error = error or found.error
    if done.printed or not done.error:
        typer.echo(line)
    typer.echo(indent(done.printed, "  "), nl=False)
    if error:
        note(f"error: {done.recording}: {error.removeprefix(f'{done.recording}: ')}")

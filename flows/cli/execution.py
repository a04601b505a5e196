"""Carrying a flow out for a command, and saying what came of it."""

import json
import sys
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli import replays
from flows.cli.event_log import Format, begin_log, logged
from flows.cli.options import told

if TYPE_CHECKING:
    from flows.graph import Flow
    from operators.ports import Recording, Run

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Duration = Annotated[
    str | None, typer.Option("--for", metavar="TIME", help="Stop after this time: 500ms, 30s, 5min, 1h.")
]


def apart_from(*, result: bool, log: Format) -> AbstractContextManager[object]:
    """What sinks print goes to stderr where stdout is for a result in JSON; a log for programs stays."""
    return redirect_stdout(sys.stderr) if result and log is Format.TEXT else nullcontext()


def session_name(flow: "Flow") -> str:
    """What a session that begins now is called."""
    from datetime import UTC, datetime

    return f"{flow.name}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z"


async def execute(
    flow: "Flow",
    *,
    log: Format,
    limit: int | None = None,
    recording: "Recording | None" = None,
    pace: float | None = None,
) -> "Run":
    """Run a flow: live, or over a recording.

    Args:
        flow: To be run.
        log: How what happens is told.
        limit: When a live or a paced run ends at the latest, ns.
        recording: To be replayed; None: it runs live.
        pace: Of the replay, a multiple of real time; None: full speed.

    Raises:
        SlipflowError: if it cannot begin, or a replay fails.
    """
    from flows.run.clocks import LoopClock
    from flows.run.live_runner import LiveRunner
    from flows.run.replay_runner import ReplayRunner, first_time, replayed, tell_places
    from flows.run.stop_signals import stopping

    begin_log(log)
    if recording is not None:
        tell_places(flow)
    session = session_name(flow)
    if recording is not None and pace is None:
        replay, show = ReplayRunner(flow, recording, session), replays.progress(recording)
        with stopping() as stopped, logged(replay.run):
            return await replay.execute(lambda run: replay.stop() if stopped() else show(run))
    clock = None if recording is None else LoopClock(first_time(recording), pace or 1.0)
    flow = flow if recording is None else replayed(flow, recording)
    live = LiveRunner(flow, session, clock=clock, duration=limit)
    with logged(live.run):
        return await live.execute()


def finish(run: "Run", *, replayed: Path | None, seconds: float, log: Format, as_json: bool) -> None:
    """Say what a run came to; it took so many `seconds` of wall time.

    Exits 130 if it was interrupted, 1 if a source was down at its end or rows were lost.
    """
    from flows.run.parallel_replay import Replayed
    from flows.run.run_summary import Summary

    summary = Summary.of(run)
    if as_json and replayed:
        typer.echo(replays.as_json([Replayed(str(replayed), summary, error=run.error)], seconds))
    elif as_json:
        typer.echo(json.dumps(summary.as_dict()))
    elif log is Format.TEXT:  # else the log has told it
        typer.echo(summary.report())
    if run.error:
        told(f"error: {run.error}")
        raise typer.Exit(130)
    if summary.lost:
        raise typer.Exit(1)

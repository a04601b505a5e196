"""Execution of a flow for a command, and the report of its result."""

import json
import logging
import sys
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from typing import TYPE_CHECKING, Any, cast

import typer

from flows.cli.event_log import Format, logged
from flows.cli.terminal import note

if TYPE_CHECKING:
    from flows.graph import Flow
    from operators.ports import Recording, Run, Source

models = logging.getLogger("slipflow.models")


def separate_result(*, as_json: bool, log: Format) -> AbstractContextManager[object]:
    """Redirect the output of sinks to stderr if stdout is for a JSON result; a JSON log stays on stdout."""
    return redirect_stdout(sys.stderr) if as_json and log is Format.TEXT else nullcontext()


def session_name(flow: "Flow") -> str:
    """Return the name of a session that starts now."""
    from datetime import UTC, datetime

    return f"{flow.name}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z"


async def execute(
    flow: "Flow", *, limit: int | None = None, recording: "Recording | None" = None, pace: float = 1.0
) -> "Run":
    """Run a flow in real time: live, or over a recording.

    Args:
        flow: Flow to run.
        limit: Longest duration, ns.
        recording: Recording to replay; None: run live.
        pace: Speed of the replay as a multiple of real time.

    Raises:
        SlipflowError: if the run cannot start.
    """
    from flows.run.clocks import LoopClock
    from flows.run.live_runner import LiveRunner
    from flows.run.replay_runner import first_time, log_replay_destinations, replayed, replayed_recording
    from flows.run.stop_signals import signals_to

    log_models(flow)
    clock = None if recording is None else LoopClock(first_time(recording), pace)
    flow = flow if recording is None else replayed(flow, recording)
    if replayed_recording(cast("Source[Any]", node.part) for node in flow.sources()) is not None:
        log_replay_destinations(flow)
    live = LiveRunner(flow, session_name(flow), clock=clock, duration=limit, signals=False)
    with signals_to(live.stop), logged(live.run):  # the log announces a run that signals already end
        return await live.execute()


def log_models(flow: "Flow") -> None:
    """Log what each shipped model of a flow is meant for."""
    from operators.score import Score

    detectors = [node.part.detector for node in flow.nodes if isinstance(node.part, Score)]
    for purpose in dict.fromkeys(getattr(each, "purpose", "") for each in detectors):
        if purpose:
            models.info("model %s", purpose)


def report_run(run: "Run", *, log: Format, as_json: bool) -> None:
    """Print the result of a run.

    Exits 130 if it was interrupted, 1 if a source was down or silent at its end, or rows were lost.
    """
    from flows.run.run_summary import Summary

    summary = Summary.of(run)
    if as_json:
        typer.echo(json.dumps(summary.as_dict()))
    elif log is Format.TEXT:  # a JSON log ends with the same data
        typer.echo(summary.report())
    if run.error:
        note(f"error: {run.error}")
        raise typer.Exit(130)
    if summary.lost:
        raise typer.Exit(1)

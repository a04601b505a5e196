"""Execution of a flow for a command, live or over recordings, and the report of its result."""

import json
import logging
from textwrap import indent
from typing import TYPE_CHECKING, Any

import typer

from flows.cli.event_log import Format, logged
from flows.cli.terminal import note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from flows.graph import Flow
    from flows.run.replays import Replayed
    from operators.ports import Recording, Run

models = logging.getLogger("slipflow.models")


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
    from flows.run.supervision import signals_to

    log_models(flow)
    clock = None if recording is None else LoopClock(first_time(recording), pace)
    flow = flow if recording is None else replayed(flow, recording)
    if replayed_recording(flow) is not None:
        log_replay_destinations(flow)
    live = LiveRunner(flow, session_name(flow), clock=clock, duration=limit)
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
        raise typer.Exit(130)
    if summary.lost:
        raise typer.Exit(1)


def replay_all(
    target: str,
    settings: "Mapping[str, str]",
    paths: "Sequence[Path]",
    *,
    jobs: int | None,
    cluster: str | None,
    as_json: bool,
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
    if (existing := len(replays.existing)) and not as_json:
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
                    raise SlipflowError(each.error)
                if not done:
                    log_models(replays.flow)
                done.append(each)
                _print(each, as_json=as_json)
        except KeyboardInterrupt:
            note("interrupted: repeat the command to continue with the missing sessions")
            raise
    seconds = perf_counter() - began
    if as_json:
        sessions = [_as_dict(each) for each in done]
        typer.echo(json.dumps({"sessions": sessions, "existing": existing, "wall_seconds": seconds}))
    else:
        typer.echo(_total(done, seconds))
    if any(each.error or (each.summary and each.summary.lost) for each in done):
        raise typer.Exit(1)


def _print(done: "Replayed", *, as_json: bool) -> None:
    """Print the output of a replay, on stderr if stdout is for JSON."""
    if done.printed or not (done.error or as_json):
        typer.echo(_line(done), err=as_json)
    typer.echo(indent(done.printed, "  "), nl=False, err=as_json)
    if error := done.error or (done.summary.error if done.summary else ""):
        note(f"error: {done.recording}: {error.removeprefix(f'{done.recording}: ')}")


def _line(done: "Replayed") -> str:
    if not done.summary:
        return f"{done.recording}:"
    sources = ", ".join(f"{source.rows:,} {name}" for name, source in done.summary.sources.items())
    sinks = ", ".join(f"{sink.rows:,} to {name}" for name, sink in done.summary.sinks.items())
    return f"{done.recording} -> {done.summary.session}: {done.summary.seconds:.1f} s, {sources}; {sinks}"


def _total(done: "Sequence[Replayed]", seconds: float) -> str:
    found = [each.summary for each in done if each.summary]
    rows = counted(sum(each.rows_in for each in found), "row")
    failed = sum(1 for each in done if each.error)
    failures = f"; {failed} failed" if failed else ""
    return f"{counted(len(done), 'recording')}, {rows} in {seconds:.1f} s{failures}"


def _as_dict(done: "Replayed") -> dict[str, Any]:
    summary = done.summary.as_dict() if done.summary else {}
    return {"recording": done.recording, "error": done.error or None, **summary}

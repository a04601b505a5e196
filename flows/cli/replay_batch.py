"""Replay of recordings at full speed: progress, output under each recording's name, and totals."""

import json
from collections.abc import Sequence
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any

import typer

from flows.cli.execution import log_models
from flows.cli.terminal import note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from flows.run.replays import Replayed


def replay_all(
    target: str,
    settings: "Mapping[str, str]",
    paths: Sequence[Path],
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
    if done.error:
        note(f"error: {done.recording}: {done.error.removeprefix(f'{done.recording}: ')}")


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

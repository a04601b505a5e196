"""Replay of several recordings: progress, output under each recording's name, and totals."""

import json
from collections.abc import Sequence
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any

import typer

from flows.cli.terminal import note, progress_bar
from flows.report.table import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from flows.run.parallel_replay import Replayed


def replay_all(
    target: str,
    settings: "Mapping[str, str]",
    recordings: Sequence[Path],
    session: str,
    jobs: int | None,
    *,
    as_json: bool,
) -> None:
    """Replay several recordings, each to its own session, and print the results in their order.

    Ctrl-C commits what was recorded. Exits 1 if a replay failed or lost rows, 130 if interrupted.
    """
    from time import perf_counter

    from flows.run.parallel_replay import Replays
    from flows.run.stop_signals import stopping

    replays = Replays(target, settings, recordings, session)
    if jobs is None and (exclusive := replays.exclusive_sinks):
        note(f"replaying one recording at a time: only one process can write to {', '.join(exclusive)}")
    began, done = perf_counter(), list["Replayed"]()
    with stopping() as stopped, progress_bar(f"replaying {target}") as update:
        for each in replays.run(
            jobs,
            stopped=stopped,
            progress=lambda number: update(number, len(recordings)),
        ):
            if each.printed or not (each.error or as_json):
                typer.echo(_line(each), err=as_json)
            typer.echo(indent(each.printed, "  "), nl=False, err=as_json)
            if each.error and (each.summary or not stopped()):
                note(f"error: {each.recording}: {each.error.removeprefix(f'{each.recording}: ')}")
            done.append(each)
        interrupted = stopped()
    seconds = perf_counter() - began
    typer.echo(replays_as_json(done, seconds) if as_json else _total(done, seconds))
    if interrupted:
        raise typer.Exit(130)
    if any(each.error or (each.summary and each.summary.lost) for each in done):
        raise typer.Exit(1)


def replays_as_json(done: "Sequence[Replayed]", seconds: float) -> str:
    """Return the results of one or more replays that took `seconds` of wall time as JSON."""
    return json.dumps({"sessions": [_as_dict(each) for each in done], "wall_seconds": seconds})


def _line(done: "Replayed") -> str:
    if not done.summary:  # what the flow's file printed
        return f"{done.recording}:"
    sources = ", ".join(f"{source.rows:,} {name}" for name, source in done.summary.sources.items())
    sinks = ", ".join(f"{sink.rows:,} to {name}" for name, sink in done.summary.sinks.items())
    return f"{done.recording} -> {done.summary.session}: {done.summary.seconds:.1f} s, {sources}; {sinks}"


def _total(done: "Sequence[Replayed]", seconds: float) -> str:
    found = [each.summary for each in done if each.summary]
    rows = counted(sum(each.rows_in for each in found), "row")
    failed = sum(1 for each in done if each.error)
    incomplete = f"; {failed} incomplete" if failed else ""
    return f"{counted(len(done), 'recording')}, {rows} in {seconds:.1f} s{incomplete}"


def _as_dict(done: "Replayed") -> dict[str, Any]:
    summary = done.summary.as_dict() if done.summary else {}
    return {"recording": done.recording, "error": done.error or None, **summary}

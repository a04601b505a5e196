"""What `slipflow run --replay` does; `flows.cli.run` calls it."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any

import typer

from flows.cli.options import counted, progress_bar, told

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from flows.run.parallel_replay import Replayed
    from operators.ports import Recording, Run

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415


def replay(
    target: str,
    settings: "Mapping[str, str]",
    recordings: Sequence[Path],
    session: str,
    jobs: int | None,
    *,
    in_json: bool,
) -> None:
    """Replay several recordings, each to a session of its own, and say what came of each.

    What sinks print comes in the order of the recordings, each below its name. Ctrl-C commits what there is.

    Exits 1 if one of them failed or lost rows, 130 if it was interrupted.
    """
    from time import perf_counter

    from flows.run.parallel_replay import Replays
    from flows.run.stop_signals import stopping

    replays = Replays(target, settings, recordings, session)
    if jobs is None and (lonely := replays.lonely()):
        told(f"one recording after the other: only one process may write to {', '.join(lonely)}")
    began, done = perf_counter(), list["Replayed"]()
    with stopping() as stopped, progress_bar(f"replaying {target}") as update:
        for each in replays.run(
            jobs,
            stopped=stopped,
            progress=lambda number, rows: update(number, len(recordings), f"{rows:,} rows"),
        ):
            if each.printed or not (each.error or in_json):
                typer.echo(_line(each), err=in_json)
            typer.echo(indent(each.printed, "  "), nl=False, err=in_json)
            if each.error and (each.summary or not stopped()):
                told(f"error: {each.recording}: {each.error.removeprefix(f'{each.recording}: ')}")
            done.append(each)
        interrupted = stopped()
    seconds = perf_counter() - began
    if in_json:
        typer.echo(as_json(done, seconds))
    else:
        typer.echo(_total(done, seconds))
    if interrupted:
        raise typer.Exit(130)
    if any(each.error or (each.summary and each.summary.lost) for each in done):
        raise typer.Exit(1)


def progress(recording: "Recording") -> "Callable[[Run], None]":
    """Say how far a replay is, where a person is looking."""
    from rich.console import Console
    from rich.status import Status

    status = Status(f"replaying {recording.name}", console=Console(stderr=True))
    if sys.stderr.isatty():
        status.start()

    def show(run: "Run") -> None:
        rows = sum(source.rows for source in run.sources.values())
        status.update(f"replaying {recording.name}: {(run.clock.now() - run.start) / 1e9:.1f} s, {rows} rows")

    return show


def as_json(done: "Sequence[Replayed]", seconds: float) -> str:
    """What came of replays in `seconds` by the wall's clock, of one as of many, for a program."""
    return json.dumps({"sessions": [_as_dict(each) for each in done], "wall_seconds": seconds})


def _line(done: "Replayed") -> str:
    assert done.summary, "what has none has printed nothing"
    sources = ", ".join(f"{source.rows:,} {name}" for name, source in done.summary.sources.items())
    sinks = ", ".join(f"{sink.rows:,} to {name}" for name, sink in done.summary.sinks.items())
    return f"{done.recording} -> {done.summary.session}: {done.summary.seconds:.1f} s, {sources}; {sinks}"


def _total(done: "Sequence[Replayed]", seconds: float) -> str:
    found = [each.summary for each in done if each.summary]
    rows = counted(sum(each.taken for each in found), "row")
    failed = sum(1 for each in done if each.error)
    ended = f"; {failed} of them not to the end" if failed else ""
    return f"{counted(len(done), 'recording')}, {rows} in {seconds:.1f} s{ended}"


def _as_dict(done: "Replayed") -> dict[str, Any]:
    about = done.summary.as_dict() if done.summary else {}
    return {"recording": done.recording, "error": done.error or None, **about}
